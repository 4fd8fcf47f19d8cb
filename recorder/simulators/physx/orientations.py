"""Orientations that PhysX holds bit for bit after it has normalised what it was given."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_TRIES = 4096
_STEP = np.float32(2.0**-18)  # lengths that are tried differ from 1 by less than 0.8 %


def normalised(quaternions: NDArray[np.float32]) -> NDArray[np.float32]:
    """What PhysX makes of quaternions [row, xyzw] that are written, in float32: each times 1 over its length."""
    x, y, z, w = quaternions.T
    return np.asarray(quaternions * (np.float32(1) / np.sqrt(x * x + y * y + z * z + w * w))[:, None])


def to_write(quaternions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quaternions [row, xyzw] that become the given ones when they are normalised.

    A unit quaternion in float32 is often not what its own normalisation gives. Where none is found, and where a row is
    not finite, the row is returned as it is.
    """
    found = quaternions.copy()
    left = np.flatnonzero((normalised(quaternions) != quaternions).any(axis=1) & np.isfinite(quaternions).all(axis=1))
    for attempt in range(_TRIES):
        if not left.size:
            break
        scale = 1 + _STEP * np.float32(attempt // 2 + 1) * (-1 if attempt % 2 else 1)
        wanted = quaternions[left]
        given = wanted * scale
        for _ in range(3):
            short = wanted - normalised(given)
            given = np.where(short == 0, given, np.nextafter(given, np.sign(short) * np.float32(2)))
        held = (normalised(given) == wanted).all(axis=1)
        found[left[held]] = given[held]
        left = left[~held]
    return found
