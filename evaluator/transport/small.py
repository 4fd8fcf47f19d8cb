"""W1 between all pairs of many small point sets, exact."""

from __future__ import annotations

import importlib.util
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evaluator.metrics.identity import bitwise_classes
from evaluator.transport.assignment import mean_assignment_distance
from evaluator.transport.points import (
    distance_matrix,
    in_canonical_order,
    point_array,
    scale_of,
    scaled_back,
    squares_vanish,
)

KERNEL_PAIRS = 20_000
"""From so many pairs on, compiled code saves more than loading it costs."""

SUMMARY_ROWS = 64
"""Rows of distances that a summary holds and adds up at a time; part of the result's last bits."""


@dataclass(frozen=True)
class DistinctSets:
    """Point sets without their repetitions.

    sets      one of each [any length unit], points in canonical order, shape [n_set, n_item, d]
    classes   which of them each env holds, shape [n_env]
    """

    sets: npt.NDArray[np.float64]
    classes: npt.NDArray[np.int64]


@dataclass(frozen=True)
class PairwiseSummary:
    """W1 over all pairs of envs, without the matrix, in the unit of the points.

    mean        over pairs e < e', those of equal envs among them
    row_means   of each env, over all others, shape [n_env]
    n_distinct  number of distinct point sets; swapped items make no difference
    """

    mean: float
    row_means: npt.NDArray[np.float64]
    n_distinct: int


def distinct_sets(points: npt.ArrayLike) -> DistinctSets:
    """The distinct ones of point sets, shape [n_env, n_item, d].

    Sets that hold the same points, in whatever order, are one set, numbered by first appearance.

    Raises:
        ValueError: the points are empty, not of three axes, or not finite.
    """
    sets = in_canonical_order(point_array(points, "points", ndim=3))
    classes = bitwise_classes(sets)
    _, first = np.unique(classes, return_index=True)
    return DistinctSets(sets[first], classes)


def pairwise_wasserstein1(points: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """W1 between every pair of equally sized point sets (GPUSimBench definition).

        W[e, e'] = min over one-to-one assignments s of  (1/n) * sum_i |p[e, i] - p[e', s(i)]|

    Sets that hold the same points, in whatever order, are one set: each pair of distinct sets is
    solved once, so that a simulator whose envs agree costs nothing however many they are.

    Args:
        points: positions [any length unit], shape [n_env, n_item, d].

    Returns:
        distances [same unit], shape [n_env, n_env]; symmetric, zero on the diagonal.

    Raises:
        ValueError: the points are empty, not of three axes, or not finite; a distance overflows.
    """
    found = distinct_sets(points)
    upper = _rows(found.sets, 0, len(found.sets), _cores())
    return (upper + upper.T)[np.ix_(found.classes, found.classes)]


def pairwise_summary(points: npt.ArrayLike) -> PairwiseSummary:
    """Mean W1 over all pairs of envs, and of each env, in memory that grows with n_env alone.

    A pair of distinct sets counts as often as there are pairs of envs that hold them. To spread it
    over workers, see `summary_block` and `summed_up`.

    Args:
        points: positions [any length unit], shape [n_env, n_item, d].

    Raises:
        ValueError: as of pairwise_wasserstein1, or fewer than two envs.
    """
    found = distinct_sets(points)
    if len(found.classes) < 2:
        raise ValueError("a mean over pairs needs at least two envs, got 1")
    counts = np.bincount(found.classes)
    sums = np.zeros(len(found.sets))
    for first in range(0, len(found.sets), SUMMARY_ROWS):
        sums += summary_block(found.sets, counts, first, threads=_cores())
    return summed_up(found.classes, sums)


def pair_block(
    sets: npt.NDArray[np.float64], first_row: int, last_row: int, *, threads: int = 1
) -> npt.NDArray[np.float64]:
    """W1 between sets first_row <= i < last_row and all sets j > i, in order of i, then j.

    The blocks of all rows in order, put end to end, are the upper triangle of the matrix, as
    `scipy.spatial.distance.squareform` takes it: the same bits however the rows are divided and
    whatever the number of threads. Which solver is used follows from the number of sets alone.

    Args:
        sets: distinct sets [any length unit], shape [n_set, n_item, d].
        first_row, last_row: rows of the block.
        threads: to compute on; only compiled code, for many pairs, uses more than one.

    Returns:
        distances [same unit], shape [pairs of the block].

    Raises:
        ValueError: a distance overflows; there are no such rows.
    """
    if not 0 <= first_row <= last_row <= len(sets):
        raise ValueError(f"no rows {first_row} to {last_row} of {len(sets)} sets")
    rows = _rows(sets, first_row, last_row, threads)
    later = [row[i + 1 :] for i, row in enumerate(rows, first_row)]
    return np.concatenate([np.empty(0), *later])


def summary_block(
    sets: npt.NDArray[np.float64], counts: npt.NDArray[np.int64], first_row: int, *, threads: int = 1
) -> npt.NDArray[np.float64]:
    """What the SUMMARY_ROWS rows from first_row on add to every set's sum of distances.

    Sums of the blocks, in order, are those that `summed_up` takes. The blocks are not divided
    otherwise, so that additions are the same whoever computes them.

    Args:
        sets: distinct sets [any length unit], shape [n_set, n_item, d].
        counts: how many envs hold each, shape [n_set].
        first_row: a multiple of SUMMARY_ROWS.
        threads: as in pair_block.

    Returns:
        sums over envs of distances [same unit], shape [n_set].
    """
    last_row = min(first_row + SUMMARY_ROWS, len(sets))
    block = _rows(sets, first_row, last_row, threads)
    sums: npt.NDArray[np.float64] = (block * counts[first_row:last_row, None]).sum(axis=0)
    sums[first_row:last_row] += (block * counts).sum(axis=1)
    return sums


def summed_up(classes: npt.NDArray[np.int64], sums: npt.NDArray[np.float64]) -> PairwiseSummary:
    """The summary of envs of the given classes [n_env] from every set's sum of distances [n_set]."""
    counts = np.bincount(classes)
    others = len(classes) - 1
    mean = float((sums * counts).sum()) / (len(classes) * others)
    return PairwiseSummary(mean, (sums / others)[classes], len(sums))


def _rows(sets: npt.NDArray[np.float64], first: int, last: int, threads: int) -> npt.NDArray[np.float64]:
    """W1 from the rows first to last to all later sets, zero elsewhere, shape [last - first, n_set]."""
    scale = scale_of(sets)
    unit = sets / scale
    result = np.zeros((last - first, len(sets)))
    if _use_kernel(unit):
        from evaluator.transport.kernel import distances_to_later

        columns = np.ascontiguousarray(unit.swapaxes(1, 2))

        def fill(row: int) -> None:
            distances_to_later(columns, row, result[row - first])

        if threads > 1:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(fill, range(first, last)))
        else:
            for row in range(first, last):
                fill(row)
    else:
        for row in range(first, last):
            _fill_with_scipy(unit, row, result[row - first])
    scaled_back(float(result.max(initial=0.0)), scale)
    result *= scale
    return result


def _use_kernel(unit: npt.NDArray[np.float64]) -> bool:
    # a property of all sets, so that it is the same for every block
    n_set = len(unit)
    many = n_set * (n_set - 1) // 2 >= KERNEL_PAIRS
    return many and not squares_vanish(unit) and importlib.util.find_spec("numba") is not None


def _fill_with_scipy(sets: npt.NDArray[np.float64], row: int, out: npt.NDArray[np.float64]) -> None:
    n_set, n_item, width = sets.shape
    if row + 1 == n_set:
        return
    # One call builds the distances to all later sets: per pair, building costs more than solving.
    later = sets[row + 1 :].reshape(-1, width)
    blocks = distance_matrix(sets[row], later).reshape(n_item, -1, n_item)
    for other in range(row + 1, n_set):
        out[other] = mean_assignment_distance(blocks[:, other - row - 1])


def _cores() -> int:
    # that this process may use; not every system can tell
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
