"""A 64-bit hash of one environment's state at one step.

The state's numbers are taken as unsigned words of their own size, in the order of the recording's fields, items and
components. With word w_i at position i (from 0) and 64-bit wrapping arithmetic,

    hash = sum over i of mix(w_i + (i + 1) * 0x9E3779B97F4A7C15)

where mix is the finaliser of SplitMix64 (``schemas.splitmix``). mix is a bijection, so a change of one word always
changes the hash; several changes cancel with a probability of 2^-64. A sum does not depend on the order of its terms,
so a GPU may add them in any order and gets the same bits. Not a defence against forgery: that is what the SHA-256
digests of the end record are for.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.splitmix import GOLDEN, mix_in_place

ALGORITHM = "sum-splitmix64-v1"

_WORD = {4: "<u4", 8: "<u8"}

_CACHED_WORDS = 1 << 15  # at a time: two buffers of these stay in a core's cache


def fingerprint(arrays: Sequence[NDArray[np.floating]]) -> NDArray[np.uint64]:
    """Hashes of states, shape [...], from the state's fields in recording order.

    arrays  each [..., item, width], float32 or float64, with the same leading shape ([env] or [step, env])
    """
    lead = arrays[0].shape[:-2]
    total = np.zeros(lead, dtype=np.uint64)
    flat = total.reshape(-1)
    position = 0
    for array in arrays:
        if array.shape[:-2] != lead:
            raise ValueError(f"leading shapes differ: {array.shape[:-2]} and {lead}")
        count = array.shape[-2] * array.shape[-1]
        words = np.ascontiguousarray(array).view(_WORD[array.dtype.itemsize]).reshape(len(flat), count)
        key = np.arange(position + 1, position + count + 1, dtype=np.uint64) * np.uint64(GOLDEN)
        rows = max(1, _CACHED_WORDS // max(1, count))
        mixed, spare = np.empty((2, min(rows, len(flat)), count), dtype=np.uint64)
        for begin in range(0, len(flat), rows):
            part = words[begin : begin + rows]
            some = mixed[: len(part)]
            np.add(part, key, out=some)
            mix_in_place(some, spare[: len(part)])
            flat[begin : begin + rows] += some.sum(axis=1, dtype=np.uint64)
        position += count
    return total
