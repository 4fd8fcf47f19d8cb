"""Hashes of a program's arrays, boiled down to what comparing runs needs."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.program import Updates
from gpusimbench.evaluator.read.recording import Recording


@dataclass(frozen=True)
class ArrayHistory:
    """Updates of the arrays of one name.

    states   how many states precede each, shape [update]
    order    number of each among the updates of all names, shape [update]
    digests  128-bit digest of each: of names, dtypes, shapes and hashes of its arrays, and of `states`; [update, 2]
    """

    states: NDArray[np.int64]
    order: NDArray[np.int64]
    digests: NDArray[np.uint64]


def array_histories(recording: Recording) -> dict[str, ArrayHistory]:
    """By name; empty where the program hashed no arrays."""
    return {name: _history(updates) for name, updates in recording.program.items()}


def _history(updates: Updates) -> ArrayHistory:
    digests = [
        hashlib.blake2b(
            "\0".join([str(states), *arrays]).encode(errors="replace") + hashes.tobytes(), digest_size=16
        ).digest()
        for states, arrays, hashes in zip(updates.states, updates.arrays, updates.hashes, strict=True)
    ]
    return ArrayHistory(updates.states, updates.order, np.frombuffer(b"".join(digests), dtype=np.uint64).reshape(-1, 2))
