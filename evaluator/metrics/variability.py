"""Variability: how far envs of one run, and runs of one configuration, lie apart."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from evaluator.metrics.identity import bitwise_classes, count_distinct
from evaluator.transport.pair import wasserstein1
from evaluator.transport.points import in_canonical_order, planar_array
from evaluator.transport.small import pairwise_summary, pairwise_wasserstein1

CM_PER_M = 100.0

MATRIX_ENVS = 1024
"""With more envs than this no matrix of them is kept: it would grow with their square, and has cells finer than any
picture shows."""


@dataclass(frozen=True)
class ParallelVariability:
    """Env-to-env variability within one run.

    mean_cm      mean W1 over env pairs e < e' [cm]
    matrix_cm    W1 between envs [cm], shape [n_env, n_env]; None with more than MATRIX_ENVS envs,
                 for which it would take gigabytes
    env_means_cm mean W1 from each env to all others [cm], shape [n_env]
    n_distinct   number of bitwise different envs; 1 is stronger than a mean of 0.00, since envs
                 whose items only swapped places also have distance zero
    """

    mean_cm: float
    matrix_cm: npt.NDArray[np.float64] | None
    env_means_cm: npt.NDArray[np.float64]
    n_distinct: int


@dataclass(frozen=True)
class RunToRun:
    """Run-to-run variability of one configuration.

    mean_cm      mean W1 over run pairs r < r' [cm]
    exactness    "exact": the optimum up to float64 rounding; "certified" where a pair is only known
                 between bounds: values are then of upper bounds
    low_cm       mean of the lower bounds [cm]; mean_cm where it is exact
    sd_cm        standard deviation over the pairs [cm] (n - 1 in the denominator); None for one
                 pair. As published: the pairs share runs, so it is no standard error.
    matrix_cm    W1 between runs [cm], shape [n_run, n_run]
    n_distinct   number of bitwise different runs
    """

    mean_cm: float
    sd_cm: float | None
    matrix_cm: npt.NDArray[np.float64]
    n_distinct: int
    exactness: str
    low_cm: float


def sampling_step(t_s: float, dt: float) -> int:
    """Step at which the outcome is sampled (GPUSimBench definition): N_s = round(t_s / dt).

    Args:
        t_s: sampling time [s].
        dt: time step [s].

    Raises:
        ValueError: the time is negative, the step is not positive, or either is not finite.
    """
    if not (math.isfinite(t_s) and t_s >= 0.0):
        raise ValueError(f"sampling time must be finite and not negative, got {t_s} s")
    if not (math.isfinite(dt) and dt > 0.0):
        raise ValueError(f"time step must be positive and finite, got {dt} s")
    return round(t_s / dt)


def parallel_variability(positions: npt.ArrayLike) -> ParallelVariability:
    """Parallel variability of one run (GPUSimBench definition).

        mean over env pairs e < e' of  W1(e, e')

    Args:
        positions: planar item positions [m] at the sampling step, relative to each env's own
            origin, shape [n_env, n_item, 2].

    Raises:
        ValueError: fewer than two envs, or positions that are empty, not planar or not finite.
    """
    positions = np.asarray(positions)
    points = planar_array(positions, "positions", ndim=3)
    n_env = len(points)
    if n_env < 2:
        raise ValueError("parallel variability needs at least two envs, got 1")
    n_distinct = count_distinct(positions)
    if n_env > MATRIX_ENVS:
        summary = pairwise_summary(points)
        return ParallelVariability(summary.mean * CM_PER_M, None, summary.row_means * CM_PER_M, n_distinct)
    matrix = pairwise_wasserstein1(points) * CM_PER_M
    # The diagonal is zero and every pair stands twice in the sum.
    mean = float(matrix.sum()) / (n_env * (n_env - 1))
    return ParallelVariability(mean, matrix, matrix.sum(axis=1) / (n_env - 1), n_distinct)


def run_to_run_variability(runs: npt.ArrayLike) -> RunToRun:
    """Run-to-run variability of one configuration (GPUSimBench definition).

        mean over run pairs r < r' of  W1(r, r'),  each run the n_env * n_item points of its envs

    Args:
        runs: planar item positions [m] at the sampling step, relative to each env's own origin,
            shape [n_run, n_env, n_item, 2].

    Raises:
        ValueError: fewer than two runs, or positions that are empty, not planar or not finite.
    """
    runs = np.asarray(runs)
    points = planar_array(runs, "runs", ndim=4)
    n_run = len(points)
    if n_run < 2:
        raise ValueError("run-to-run variability needs at least two runs, got 1")
    matrix, lowest = (bounds * CM_PER_M for bounds in _between_runs(points.reshape(n_run, -1, 2)))
    mean, sd = _over_pairs(matrix)
    exactness = "exact" if np.array_equal(matrix, lowest) else "certified"
    return RunToRun(mean, sd, matrix, count_distinct(runs), exactness, _over_pairs(lowest)[0])


def _over_pairs(matrix: npt.NDArray[np.float64]) -> tuple[float, float | None]:
    pairs = matrix[np.triu_indices(len(matrix), k=1)]
    # Measured from the first pair, so that equal pairs give exactly that value and deviation zero.
    offset = pairs - pairs[0]
    return float(pairs[0] + offset.mean()), float(offset.std(ddof=1)) if len(pairs) > 1 else None


def _between_runs(points: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Upper and lower bounds of W1 between runs, [n_run, n_point, 2] -> [n_run, n_run]; equal runs solved once."""
    sets = in_canonical_order(points)
    classes = bitwise_classes(sets)
    _, first = np.unique(classes, return_index=True)
    high = np.zeros((len(first), len(first)))
    low = np.zeros_like(high)
    for i, j in zip(*np.triu_indices(len(first), k=1), strict=True):
        found = wasserstein1(sets[first[i]], sets[first[j]])
        high[i, j] = high[j, i] = found.high
        low[i, j] = low[j, i] = found.low
    each = np.ix_(classes, classes)
    return high[each], low[each]
