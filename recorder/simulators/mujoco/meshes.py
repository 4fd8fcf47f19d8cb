"""Meshes for viewers, of fewer triangles than engines compute with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Triangles = NDArray[np.int64]

_CELLS = np.unique(np.geomspace(2, 96, 32).astype(int))[::-1]  # along the longest side, the most first


def fewer(points: Points, triangles: Triangles, most: int) -> tuple[Points, Triangles] | None:
    """A mesh of at most so many triangles: points within a cell of a grid become their mean, and triangles that lose a
    corner are left out (vertex clustering, Rossignac and Borrel 1993). None where even the coarsest grid leaves more.

    points     [point, 3]
    triangles  [triangle, 3], numbers of points
    """
    found = _used(points, triangles)
    if len(found[1]) <= most:
        return found
    points, triangles = found
    low, longest = points.min(axis=0), float(np.ptp(points, axis=0).max())
    for cells in _CELLS:
        place = np.minimum((points - low) / longest * cells, cells - 1).astype(np.int64)
        _, cell = np.unique(place @ (1, cells, cells**2), return_inverse=True)
        left = np.unique(_turned(cell[triangles]), axis=0)
        left = left[(left[:, 0] != left[:, 1]) & (left[:, 1] != left[:, 2]) & (left[:, 2] != left[:, 0])]
        if 0 < len(left) <= most:
            count = np.bincount(cell)
            means = [np.bincount(cell, weights=points[:, axis]) / count for axis in range(3)]
            return _used(np.stack(means, axis=1), left)
    return None


def grid(heights: NDArray[np.float64], x: float, y: float) -> tuple[Points, Triangles]:
    """A surface of heights [row, column] [m] above a rectangle from -x to x and from -y to y, seen from above."""
    rows, columns = heights.shape
    at_x, at_y = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]))
    corners = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return np.stack([at_x, at_y, heights], axis=-1).reshape(-1, 3), corners


def _used(points: Points, triangles: Triangles) -> tuple[Points, Triangles]:
    kept, corners = np.unique(triangles, return_inverse=True)
    return points[kept], corners.reshape(-1, 3)


def _turned(triangles: Triangles) -> Triangles:
    # the same triangles, each from its lowest number on
    first = triangles.argmin(axis=1)[:, np.newaxis]
    return np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
