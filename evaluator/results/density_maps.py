"""Density maps that can be compared: one extent, one grid and one colour scale for all groups of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.density import HexGrid, marginal
from gpusimbench.evaluator.metrics.lost_cubes import Board
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.result import Cloud, GroupResult, Map
from gpusimbench.schemas.gathering import gathered

_BIN_M = 0.01  # half a cube's edge
_MARGIN_M = 0.1
_AROUND = 0.25  # of the board's longer edge: how much of its surroundings a map shows
_HALF_EXTENT_M = 1.0  # without a board: what lies further from a group's middle is off the map
_TAIL = 0.01  # likewise: share of a group's positions at each end of an axis that the map need not hold

Extent = tuple[NDArray[np.float64], NDArray[np.float64]]


def maps_of(
    results: Sequence[GroupResult], planar: Mapping[str, NDArray[np.float64] | None], reference: Reference | None
) -> dict[str, Map]:
    """The map of each scene that has one; see `shared_map`.

    planar  positions [m] by the label of their group, each [run, env, item, 2]; None where a group has none
    """
    maps = {}
    for scene, ours in gathered((result.group.key.scene, result) for result in results).items():
        board = next((run.board for result in ours for run in result.group.complete if run.board), None)
        if shared := shared_map([planar[result.label] for result in ours], reference, scene, board):
            maps[scene] = shared
    return maps


def shared_map(
    clouds: Sequence[NDArray[np.float64] | None], reference: Reference | None, scene: str, board: Board | None = None
) -> Map | None:
    """The map of a scene: its board and the surroundings, whatever flew off; without a board, where most positions lie.

    clouds     planar positions [m], each [run, env, item, 2]; None where a group has none
    reference  joins the map where it is of the same scene
    board      of the scene; not looked at where no group has half of its positions around it

    Returns None where there are no positions, or, without a board, where groups lie too far apart for one map.
    """
    everything = [c.reshape(-1, 2) for c in clouds if c is not None]
    if reference is not None and reference.scene == scene:
        everything.append(reference.positions.reshape(-1, 2))
    if not everything:
        return None
    extent = _around(board, everything) if board else None
    extent = extent or _around_middles(everything)
    if extent is None:
        return None
    low, high = np.floor(extent[0] * 10 + 1e-9) / 10, np.ceil(extent[1] * 10 - 1e-9) / 10
    grid = HexGrid((float(low[0]), float(high[0]), float(low[1]), float(high[1])), _BIN_M)
    x, y = (np.linspace(a, b, round((b - a) / _BIN_M) + 1) for a, b in zip(low, high, strict=True))
    counts = [grid.bin(points).counts for points in everything]
    return Map(grid, (x, y), max((int(c.max()) for c in counts if len(c)), default=1))


def _around(board: Board, everything: Sequence[NDArray[np.float64]]) -> Extent | None:
    centre, size = np.array(board.centre[:2]), np.array(board.size[:2])
    reach = size / 2 + _AROUND * size.max()
    inside = [float((np.abs(points - centre) <= reach).all(axis=1).mean()) for points in everything if len(points)]
    return (centre - reach, centre + reach) if max(inside, default=0.0) >= 0.5 else None


def _around_middles(everything: Sequence[NDArray[np.float64]]) -> Extent | None:
    near = [found for points in everything if len(found := _near_its_middle(points))]
    if not near:
        return None
    low = np.min([np.quantile(points, _TAIL, axis=0, method="lower") for points in near], axis=0) - _MARGIN_M
    high = np.max([np.quantile(points, 1 - _TAIL, axis=0, method="higher") for points in near], axis=0) + _MARGIN_M
    return None if ((high - low) > 4 * _HALF_EXTENT_M).any() else (low, high)


def _near_its_middle(points: NDArray[np.float64]) -> NDArray[np.float64]:
    finite: NDArray[np.float64] = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return finite
    middle = finite[np.argmin(np.abs(finite - np.median(finite, axis=0)).max(axis=1))]
    near: NDArray[np.float64] = finite[(np.abs(finite - middle) <= _HALF_EXTENT_M).all(axis=1)]
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
