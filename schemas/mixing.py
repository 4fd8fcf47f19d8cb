"""Finalisers of two hash functions: bijections on words that leave no trace of their order.

SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014) on 64-bit words: state
hashes are defined by it, since any device computes it in a few instructions. MurmurHash3 (Austin Appleby, public
domain, fmix32) on 32-bit words: action streams are defined by it, since engines that have no 64-bit integers on their
device compute it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

GOLDEN = 0x9E3779B97F4A7C15
"""2^64 divided by the golden ratio, odd: the increment that keeps counters apart."""

GOLDEN32 = 0x9E3779B9
"""2^32 divided by the golden ratio, odd: the increment that keeps counters apart."""


def mix(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Words mixed by SplitMix64, shape and order as given; arithmetic wraps."""
    word = word.copy()
    mix_in_place(word, np.empty_like(word))
    return word


def mix_in_place(word: NDArray[np.uint64], spare: NDArray[np.uint64]) -> None:
    """The same, without memory of its own: `spare` has the shape of `word` and is overwritten."""
    _mix(word, spare, ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)), 31)


def mix32(word: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Words mixed by MurmurHash3, shape and order as given; arithmetic wraps. Also of arrays of JAX."""
    word = word ^ (word >> np.uint32(16))
    word = word * np.uint32(0x85EBCA6B)
    word = word ^ (word >> np.uint32(13))
    word = word * np.uint32(0xC2B2AE35)
    return word ^ (word >> np.uint32(16))


def mix32_in_place(word: NDArray[np.uint32], spare: NDArray[np.uint32]) -> None:
    """The same of arrays of numpy, without memory of its own: `spare` has the shape of `word` and is overwritten."""
    _mix(word, spare, ((16, 0x85EBCA6B), (13, 0xC2B2AE35)), 16)


def _mix(word: NDArray[Any], spare: NDArray[Any], rounds: Sequence[tuple[int, int]], last: int) -> None:
    # words of one type, xored with themselves shifted and multiplied, and at last xored once more
    of = word.dtype.type
    for shift, factor in rounds:
        np.right_shift(word, of(shift), out=spare)
        np.bitwise_xor(word, spare, out=word)
        np.multiply(word, of(factor), out=word)
    np.right_shift(word, of(last), out=spare)
    np.bitwise_xor(word, spare, out=word)
