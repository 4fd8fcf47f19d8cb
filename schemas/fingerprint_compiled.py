"""State hashes as machine code, one pass, ten times as fast as numpy's passes; importing this module imports numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from gpusimbench.schemas.mixing import GOLDEN

_GOLDEN = np.uint64(GOLDEN)
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)


def _add_hashes(words: Any, position: Any, total: Any) -> None:
    """Add to total [row] the mixed words [row, word], the first of which is the state's word `position`."""
    for row in range(words.shape[0]):
        hashed = np.uint64(0)
        for place in range(words.shape[1]):
            word = np.uint64(words[row, place]) + (np.uint64(position) + np.uint64(place) + np.uint64(1)) * _GOLDEN
            word = (word ^ (word >> _SHIFTS[0])) * _FACTORS[0]
            word = (word ^ (word >> _SHIFTS[1])) * _FACTORS[1]
            hashed += word ^ (word >> _SHIFTS[2])
        total[row] += hashed


def _compile() -> Callable[[Any, int, Any], None]:
    if numba.config.DISABLE_JIT:  # a loop of Python's own would take a thousand times as long as numpy
        raise ImportError("numba compiles nothing: NUMBA_DISABLE_JIT is set")
    try:
        made = numba.njit(cache=True, nogil=True)(_add_hashes)
    except RuntimeError:  # neither the folder of this file nor the user's cache can be written to
        made = numba.njit(nogil=True)(_add_hashes)
    for word in (np.uint32, np.uint64):  # now, and not while states are captured
        made(np.zeros((1, 1), dtype=word), 0, np.zeros(1, dtype=np.uint64))
    compiled: Callable[[Any, int, Any], None] = made
    return compiled


add_hashes = _compile()
"""_add_hashes for words of 4 and 8 bytes, C-contiguous; it lets go of the interpreter's lock."""
