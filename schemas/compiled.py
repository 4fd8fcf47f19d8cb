"""Loops over words as machine code, each in one pass: actions are drawn in about a third of numpy's time, and states
hashed in a tenth. Importing this module imports numba; what is compiled is what is asked for."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np

from gpusimbench.schemas.mixing import GOLDEN

_FACTORS_32 = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)
_SHIFTS_32 = np.uint32(16), np.uint32(13)

_GOLDEN = np.uint64(GOLDEN)
_FACTORS = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_SHIFTS = np.uint64(30), np.uint64(27), np.uint64(31)


@cache
def action_loop() -> Callable[..., None]:
    """_draw for C-contiguous arrays; it lets go of the interpreter's lock."""
    word = np.zeros(1, dtype=np.uint32)
    return _compile(_draw, (word, word, word.view(np.int32), word, word.view(np.float32), np.zeros((1, 1), np.float32)))


@cache
def hash_loop() -> Callable[[Any, int, Any], None]:
    """_add_hashes for words of 4 and 8 bytes, C-contiguous; it lets go of the interpreter's lock."""
    return _compile(
        _add_hashes, *((np.zeros((1, 1), word), 0, np.zeros(1, np.uint64)) for word in (np.uint32, np.uint64))
    )


def _draw(words: Any, joint: Any, first: Any, count: Any, grid: Any, rows: Any) -> None:
    """Fill rows [row, joint] with what the generator makes of words [row], as JointTargets.draw defines it."""
    for row in range(words.shape[0]):
        for place in range(joint.shape[0]):
            word = np.uint32(words[row] + joint[place])
            word = np.uint32((word ^ (word >> _SHIFTS_32[0])) * _FACTORS_32[0])
            word = np.uint32((word ^ (word >> _SHIFTS_32[1])) * _FACTORS_32[1])
            word = np.uint32((word ^ (word >> _SHIFTS_32[0])) >> _SHIFTS_32[0])
            index = np.uint32(np.uint32(word * count[place]) >> _SHIFTS_32[0])
            rows[row, place] = np.float32(np.int32(first[place] + np.int32(index))) * grid[place]


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


def _compile(loop: Callable[..., None], *of: tuple[Any, ...]) -> Callable[..., None]:
    # for arguments of the types of each of these
    if numba.config.DISABLE_JIT:  # a loop of Python's own would take a thousand times as long as numpy
        raise ImportError("numba compiles nothing: NUMBA_DISABLE_JIT is set")
    try:
        made: Callable[..., None] = numba.njit(cache=True, nogil=True)(loop)
    except RuntimeError:  # neither the folder of this file nor the user's cache can be written to
        made = numba.njit(nogil=True)(loop)
    for arguments in of:  # now, and not while states are captured
        made(*arguments)
    return made
