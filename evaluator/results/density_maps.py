"""Density maps that can be compared: one extent, one grid and one colour scale for all groups of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.density import HexGrid, marginal
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.result import Cloud, GroupResult, Map

_BIN_M = 0.01  # half a cube's edge
_MARGIN_M = 0.1
_HALF_EXTENT_M = 1.0  # what lies further from a group's middle is off the map: one outlier must not shrink all maps


def shared_map(clouds: Sequence[NDArray[np.float64] | None], reference: Reference | None, scene: str) -> Map | None:
    """The map of a scene.

    clouds     planar positions [m], each [run, env, item, 2]; None where a group has none
    reference  joins the map where it is of the same scene

    Returns None where there are no positions, or groups lie too far apart for one map.
    """
    everything = [c.reshape(-1, 2) for c in clouds if c is not None]
    if reference is not None and reference.scene == scene:
        everything.append(reference.positions.reshape(-1, 2))
    if not everything:
        return None
    near = np.concatenate([_near_its_middle(points) for points in everything])
    low = np.floor((near.min(axis=0) - _MARGIN_M) * 10) / 10
    high = np.ceil((near.max(axis=0) + _MARGIN_M) * 10) / 10
    if ((high - low) > 4 * _HALF_EXTENT_M).any():
        return None
    grid = HexGrid((float(low[0]), float(high[0]), float(low[1]), float(high[1])), _BIN_M)
    x, y = (np.linspace(a, b, round((b - a) / _BIN_M) + 1) for a, b in zip(low, high, strict=True))
    counts = [grid.bin(points).counts for points in everything]
    return Map(grid, (x, y), max((int(c.max()) for c in counts if len(c)), default=1))


def _near_its_middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    middle = points[np.argmin(np.abs(points - np.median(points, axis=0)).max(axis=1))]
    near: NDArray[np.float64] = points[(np.abs(points - middle) <= _HALF_EXTENT_M).all(axis=1)]
    return near


def with_cloud(result: GroupResult, planar: NDArray[np.float64] | None, shared: Map | None) -> GroupResult:
    """The result with its positions on the map, [run, env, item, 2]."""
    if planar is None or shared is None:
        return result
    x, y = (marginal(planar[..., axis].ravel(), shared.edges[axis]) for axis in (0, 1))
    return replace(result, cloud=Cloud(planar, shared.grid.bin(planar), (x, y)))


def reference_density(reference: Reference, shared: Map | None) -> Reference:
    """The reference with its density on the map."""
    return reference if shared is None else replace(reference, density=shared.grid.bin(reference.positions))
