"""Quaternions wxyz, in double precision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def turn_between(before: NDArray[np.floating], after: NDArray[np.floating]) -> NDArray[np.float64]:
    """Rotation vector in the world frame [rad] that leads from one orientation [..., 4] to another, shape [..., 3].

    Counter-clockwise seen against its direction; of the two ways round, the shorter.
    """
    p, q = after.astype(np.float64), before * np.array([1.0, -1.0, -1.0, -1.0])
    scalar = p[..., :1] * q[..., :1] - np.sum(p[..., 1:] * q[..., 1:], axis=-1, keepdims=True)
    vector = p[..., :1] * q[..., 1:] + q[..., :1] * p[..., 1:] + np.cross(p[..., 1:], q[..., 1:])
    vector = np.where(scalar < 0, -vector, vector)
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, np.abs(scalar))
    return np.asarray(vector * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0))
