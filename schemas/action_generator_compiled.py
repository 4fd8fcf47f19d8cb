"""Actions drawn by machine code, in one pass, in about a third of numpy's time; importing this module imports numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

_FACTORS = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)
_SHIFTS = np.uint32(16), np.uint32(13)


def _fill(words: Any, joint: Any, first: Any, count: Any, grid: Any, rows: Any) -> None:
    """Fill rows [row, joint] with what the generator makes of words [row], as JointTargets.draw defines it."""
    for row in range(words.shape[0]):
        for place in range(joint.shape[0]):
            word = np.uint32(words[row] + joint[place])
            word = np.uint32((word ^ (word >> _SHIFTS[0])) * _FACTORS[0])
            word = np.uint32((word ^ (word >> _SHIFTS[1])) * _FACTORS[1])
            word = np.uint32((word ^ (word >> _SHIFTS[0])) >> _SHIFTS[0])
            index = np.uint32(np.uint32(word * count[place]) >> _SHIFTS[0])
            rows[row, place] = np.float32(np.int32(first[place] + np.int32(index))) * grid[place]


def _compile() -> Callable[..., None]:
    if numba.config.DISABLE_JIT:  # a loop of Python's own would take a thousand times as long as numpy
        raise ImportError("numba compiles nothing: NUMBA_DISABLE_JIT is set")
    try:
        made = numba.njit(cache=True, nogil=True)(_fill)
    except RuntimeError:  # neither the folder of this file nor the user's cache can be written to
        made = numba.njit(nogil=True)(_fill)
    word = np.zeros(1, dtype=np.uint32)  # compiled now, and not while states are captured
    made(word, word, word.view(np.int32), word, word.view(np.float32), np.zeros((1, 1), dtype=np.float32))
    compiled: Callable[..., None] = made
    return compiled


fill = _compile()
"""_fill for C-contiguous arrays; it lets go of the interpreter's lock."""
