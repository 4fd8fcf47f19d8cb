"""Contacts that lie where their shapes are not."""

from __future__ import annotations

from typing import Any

import numpy as np


def misplaced(points: Any, distances: Any, centres: Any, radii: Any, numbers: Any = np) -> Any:
    """Whether contacts lie outside of one of their two shapes, bool [...].

    A contact at x with distance d is misplaced where |x - c| > 2 r + |d| for one of its shapes, whose frame has its
    origin at c and whose bounding sphere has the radius r. A correct contact lies between a point of each shape, and
    these are |d| apart: so it is within |d| of both shapes, at any depth, margin or size. Twice the radius holds for a
    sphere around any other point of the shape as well, and is more than what float32 rounds.

    points     [..., 3] in the world's frame [m]
    distances  of the surfaces [m], [...], negative where shapes penetrate each other
    centres    [..., 2, 3] in the world's frame [m]
    radii      [..., 2] [m]; 0: without a bound, such as a plane, and no point is outside
    numbers    numpy or jax.numpy; numbers that are not finite are left to who looks at the state
    """
    away = numbers.linalg.norm(points[..., None, :] - centres, axis=-1)
    return ((radii > 0) & (away > 2 * radii + abs(distances)[..., None])).any(axis=-1)
