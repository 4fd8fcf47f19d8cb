"""The finaliser of MurmurHash3 on 32-bit words: a bijection that leaves no trace of their order.

Austin Appleby, MurmurHash3 (public domain), fmix32. Action streams are defined by it: engines that have no 64-bit
integers on their device compute it too.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GOLDEN32 = 0x9E3779B9
"""2^32 divided by the golden ratio, odd: the increment that keeps counters apart."""


def mix32(word: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Mixed words, shape and order as given; arithmetic wraps."""
    word = word ^ (word >> np.uint32(16))
    word = word * np.uint32(0x85EBCA6B)
    word = word ^ (word >> np.uint32(13))
    word = word * np.uint32(0xC2B2AE35)
    return word ^ (word >> np.uint32(16))
