"""The finaliser of SplitMix64: a bijection on 64-bit words that leaves no trace of their order.

Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014. State hashes and action streams
are defined by it, since any device computes it in a few instructions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GOLDEN = 0x9E3779B97F4A7C15
"""2^64 divided by the golden ratio, odd: the increment that keeps counters apart."""


def mix(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Mixed words, shape and order as given; arithmetic wraps."""
    with np.errstate(over="ignore"):
        word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return np.asarray(word ^ (word >> np.uint64(31)))
