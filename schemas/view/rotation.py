"""Unit quaternions wxyz, as arrays [..., 4]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def about(axis: Sequence[float], angle: NDArray[Any]) -> NDArray[np.float64]:
    """Rotations about a unit vector by angles [rad], any shape; returns [..., 4]."""
    half = np.asarray(angle, dtype=np.float64) / 2
    return np.stack([np.cos(half), *(np.sin(half) * part for part in axis)], axis=-1)


def unit(quaternion: NDArray[Any]) -> NDArray[np.float64]:
    """Quaternions [..., 4] at length 1; those of length 0 as they are."""
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.asarray(quaternion / np.where(length > 0, length, 1.0), dtype=np.float64)


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
