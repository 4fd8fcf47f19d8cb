"""What becomes of images that environments observe: their hashes, or all of their numbers."""

from __future__ import annotations

from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.modes import FINAL
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.images import image_hash_note, image_hashes

HASH = "/hash"
"""Ends the names of arrays of hashes."""

Arrays = dict[str, NDArray[Any]]

_AXES = 3  # of an image: height, width, channels, in any order


class Images(Enum):
    """HASH: a 64-bit hash of each frame; NUMBERS: every number of it."""

    HASH = "hash"
    NUMBERS = "numbers"

    @classmethod
    def of(cls, word: str) -> Images:
        """From the word that a user gives; UsageError for another."""
        try:
            return cls(word)
        except ValueError:
            raise UsageError(f"images is 'hash' or 'numbers', not {word!r}") from None

    def recorded(self, arrays: Arrays, notes: dict[str, str], lead: int = 1) -> Arrays:
        """Arrays by name, with hashes in the places of observed images: uint8 with three axes or more.

        lead   axes before those of the image: [env, ...] or [step, env, ...]
        notes  gets one on each array of hashes, by its name
        """
        if self is Images.NUMBERS:
            return arrays
        found: Arrays = {}
        made: dict[int, NDArray[np.float64]] = {}  # what a step led to is often the very array that is observed
        for name, array in arrays.items():
            if not (name.startswith(("observation", FINAL)) and array.dtype == np.uint8 and array.ndim >= lead + _AXES):
                found[name] = array
                continue
            if id(array) not in made:
                made[id(array)] = image_hashes(array, lead)
            found[f"{name}{HASH}"] = made[id(array)]
            notes[f"{name}{HASH}"] = image_hash_note(array.dtype, array.shape[lead:])
        return found
