"""Unit quaternions wxyz, as arrays [..., 4]."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def about_z(angle: NDArray[Any]) -> NDArray[np.float64]:
    """Rotations about z by angles [rad], any shape; returns [..., 4]."""
    half = np.asarray(angle, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def product(first: NDArray[Any], then: NDArray[Any]) -> NDArray[np.float64]:
    """Hamilton product: `then` is a rotation in the frame that `first` leads to; shapes broadcast."""
    first, then = np.broadcast_arrays(np.asarray(first, dtype=np.float64), np.asarray(then, dtype=np.float64))
    w, v = first[..., :1], first[..., 1:]
    u, r = then[..., :1], then[..., 1:]
    return np.concatenate([w * u - (v * r).sum(-1, keepdims=True), w * r + u * v + np.cross(v, r)], axis=-1)


def rotate(quaternion: NDArray[Any], vector: NDArray[Any]) -> NDArray[np.float64]:
    """Vectors [..., 3] turned by unit quaternions [..., 4]."""
    w, v = quaternion[..., :1], quaternion[..., 1:]
    cross = np.cross(v, vector)
    turned: NDArray[np.float64] = np.asarray(vector + 2 * w * cross + 2 * np.cross(v, cross), dtype=np.float64)
    return turned
