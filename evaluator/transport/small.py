"""W1 between all pairs of many small point sets, exact."""

from __future__ import annotations

import importlib.util
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.compute.mapping import Mapper, serial
from gpusimbench.evaluator.metrics.identity import bitwise_classes
from gpusimbench.evaluator.transport.pair import mean_assignment_distance
from gpusimbench.evaluator.transport.points import (
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


def pairwise_summary(points: npt.ArrayLike, mapper: Mapper = serial) -> PairwiseSummary:
    """Mean W1 over all pairs of envs, and of each env, in memory that grows with n_env alone.

    A pair of distinct sets counts as often as there are pairs of envs that hold them.

    Args:
        points: positions [any length unit], shape [n_env, n_item, d].
        mapper: makes the blocks of SUMMARY_ROWS rows.

    Raises:
        ValueError: as of pairwise_wasserstein1, or fewer than two envs.
    """
    found = distinct_sets(points)
    if len(found.classes) < 2:
        raise ValueError("a mean over pairs needs at least two envs, got 1")
    counts = np.bincount(found.classes)
    sums = np.zeros(len(found.sets))
    for part in mapper(SummaryBlock(found.sets, counts), range(0, len(found.sets), SUMMARY_ROWS)):
        sums += part
    others = len(found.classes) - 1
    mean = float((sums * counts).sum()) / (len(found.classes) * others)
    return PairwiseSummary(mean, (sums / others)[found.classes], len(sums))


@dataclass(frozen=True)
class SummaryBlock:
    """What SUMMARY_ROWS rows add to every set's sum of distances.

    The blocks are not divided otherwise, so that additions are the same whoever computes them.

    sets    distinct sets [any length unit], shape [n_set, n_item, d]
    counts  how many envs hold each, shape [n_set]
    """

    sets: npt.NDArray[np.float64]
    counts: npt.NDArray[np.int64]

    def __call__(self, first_row: int) -> npt.NDArray[np.float64]:
        """Sums over envs of distances [same unit], shape [n_set], of the rows from first_row on."""
        last_row = min(first_row + SUMMARY_ROWS, len(self.sets))
        block = _rows(self.sets, first_row, last_row, _cores())
        sums: npt.NDArray[np.float64] = (block * self.counts[first_row:last_row, None]).sum(axis=0)
        sums[first_row:last_row] += (block * self.counts).sum(axis=1)
        return sums


def _rows(sets: npt.NDArray[np.float64], first: int, last: int, threads: int) -> npt.NDArray[np.float64]:
    """W1 from the rows first to last to all later sets, zero elsewhere, shape [last - first, n_set]."""
    scale = scale_of(sets)
    unit = sets / scale
    result = np.zeros((last - first, len(sets)))
    if _use_kernel(unit):
        from gpusimbench.evaluator.transport.kernel import distances_to_later

        columns = np.ascontiguousarray(unit.swapaxes(1, 2))

        def fill(row: int) -> None:
            distances_to_later(columns, row, result[row - first])

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(fill, range(first, last)))
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
    # that this process may use; not every system can tell, and schedulers of clusters tell by this variable
    given = os.environ.get("OMP_NUM_THREADS", "")
    if given.isdecimal() and int(given) > 0:
        return int(given)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
