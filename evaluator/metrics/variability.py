"""Variability and gap: how far envs of one run, runs of one configuration, and real trials lie apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.compute.mapping import Mapper, serial
from gpusimbench.evaluator.metrics.identity import bitwise_classes, count_distinct
from gpusimbench.evaluator.transport.pair import MATRIX_LIMIT, Transport, wasserstein1
from gpusimbench.evaluator.transport.points import in_canonical_order, planar_array
from gpusimbench.evaluator.transport.small import PairwiseSummary, pairwise_summary, pairwise_wasserstein1

CM_PER_M = 100.0

MATRIX_ENVS = 1024
"""With more envs than this no matrix of them is kept: it would grow with their square, and has cells finer than any
picture shows."""

MAX_DISTINCT = 8192
SAMPLED_ENVS = 4096
"""Of more than MAX_DISTINCT distinct envs, whose pairs would take minutes of all cores, so many are drawn."""

MAX_CERTIFIED_POINTS = 1_200_000
"""Of all pairs of runs too large for an exact distance, a side: 100,000 take some ten seconds of a core. Of more pairs,
as many are drawn."""

_SEED = 0


@dataclass(frozen=True)
class ParallelVariability:
    """Env-to-env variability within one run.

    mean_cm       mean W1 over env pairs e < e' [cm]
    exactness     "exact", or "sampled": of the pairs of SAMPLED_ENVS envs that were drawn with `seed`
    interval_cm   95 % interval for the mean over all pairs, by a jackknife over the drawn envs; None where it is exact
    matrix_cm     W1 between envs [cm], shape [n_env, n_env]; None with more than MATRIX_ENVS envs
    n_distinct    number of bitwise different envs; 1 is stronger than a mean of 0.00: envs whose items only swapped
                  places also have distance zero
    seed          of the draw
    """

    mean_cm: float
    exactness: str
    interval_cm: tuple[float, float] | None
    matrix_cm: npt.NDArray[np.float64] | None
    n_distinct: int
    seed: int = _SEED


@dataclass(frozen=True)
class RunToRun:
    """Run-to-run variability of one configuration.

    mean_cm      mean W1 over run pairs r < r' [cm]
    exactness    "exact": the optimum up to float64 rounding; "certified" where a pair is only known between bounds:
                 values are then of upper bounds; "sampled" where that is so, and only some pairs were drawn with `seed`
    low_cm       mean of the lower bounds [cm]; mean_cm where it is exact
    sd_cm        standard deviation over the pairs [cm] (n - 1 in the denominator); None for one pair. As published: the
                 pairs share runs, so it is no standard error.
    matrix_cm    W1 between runs [cm], shape [n_run, n_run]; None where not all pairs were computed
    n_pair       pairs that the mean is of
    n_distinct   number of bitwise different runs
    seed         of the draw
    """

    mean_cm: float
    exactness: str
    low_cm: float
    sd_cm: float | None
    matrix_cm: npt.NDArray[np.float64] | None
    n_pair: int
    n_distinct: int
    seed: int = _SEED


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


def parallel_variability(positions: npt.ArrayLike, mapper: Mapper = serial) -> ParallelVariability:
    """Parallel variability of one run (GPUSimBench definition).

        mean over env pairs e < e' of  W1(e, e')

    Args:
        positions: planar item positions [m] at the sampling step, relative to each env's own
            origin, shape [n_env, n_item, 2].
        mapper: makes the parts, where there are many envs.

    Raises:
        ValueError: fewer than two envs, or positions that are empty, not planar or not finite.
    """
    positions = np.asarray(positions)
    points = planar_array(positions, "positions", ndim=3)
    n_env = len(points)
    if n_env < 2:
        raise ValueError("parallel variability needs at least two envs, got 1")
    n_distinct = count_distinct(positions)
    if n_distinct > MAX_DISTINCT:
        drawn = np.random.default_rng(_SEED).choice(n_env, SAMPLED_ENVS, replace=False)
        summary = pairwise_summary(points[np.sort(drawn)], mapper)
        low, high = (end * CM_PER_M for end in _interval(summary))
        return ParallelVariability(summary.mean * CM_PER_M, "sampled", (low, high), None, n_distinct)
    if n_env > MATRIX_ENVS:
        mean = pairwise_summary(points, mapper).mean * CM_PER_M
        return ParallelVariability(mean, "exact", None, None, n_distinct)
    matrix = pairwise_wasserstein1(points) * CM_PER_M
    # The diagonal is zero and every pair stands twice in the sum.
    mean = float(matrix.sum()) / (n_env * (n_env - 1))
    return ParallelVariability(mean, "exact", None, matrix, n_distinct)


def _interval(summary: PairwiseSummary) -> tuple[float, float]:
    """95 % interval of a mean over pairs, by a delete-one-env jackknife (Arvesen 1969), in the unit of the points."""
    from scipy.special import stdtrit

    n_env = len(summary.row_means)
    # without env e: (total - row e) / pairs of the others, as a deviation from the mean over all
    without = (summary.mean - summary.row_means) * 2.0 / (n_env - 2)
    error = np.sqrt((n_env - 1) / n_env * ((without - without.mean()) ** 2).sum())
    reach = float(stdtrit(n_env - 1, 0.975) * error)
    return max(summary.mean - reach, 0.0), summary.mean + reach


def run_to_run_variability(runs: npt.ArrayLike, mapper: Mapper = serial) -> RunToRun:
    """Run-to-run variability of one configuration (GPUSimBench definition).

        mean over run pairs r < r' of  W1(r, r'),  each run the n_env * n_item points of its envs

    Args:
        runs: planar item positions [m] at the sampling step, relative to each env's own origin,
            shape [n_run, n_env, n_item, 2].
        mapper: makes the pairs.

    Raises:
        ValueError: fewer than two runs, or positions that are empty, not planar or not finite.
    """
    runs = np.asarray(runs)
    points = planar_array(runs, "runs", ndim=4)
    n_run = len(points)
    if n_run < 2:
        raise ValueError("run-to-run variability needs at least two runs, got 1")
    sets = in_canonical_order(points.reshape(n_run, -1, 2))
    classes = bitwise_classes(sets)
    _, first = np.unique(classes, return_index=True)
    distinct = list(combinations(range(len(first)), 2))  # equal runs are solved once
    affordable = max(MAX_CERTIFIED_POINTS // sets.shape[1], 1)
    if len(distinct) > affordable and sets.shape[1] ** 2 > MATRIX_LIMIT:
        return _of_some_pairs(sets, classes, count_distinct(runs), affordable, mapper)
    found = mapper(_between, [(sets[first[i]], sets[first[j]]) for i, j in distinct])
    high, low = np.zeros((2, len(first), len(first)))
    for (i, j), transport in zip(distinct, found, strict=True):
        high[i, j] = high[j, i] = transport.high * CM_PER_M
        low[i, j] = low[j, i] = transport.low * CM_PER_M
    each = np.ix_(classes, classes)
    upper = np.triu_indices(n_run, k=1)
    mean, sd = _mean_sd(high[each][upper])
    exactness = "exact" if np.array_equal(high, low) else "certified"
    lowest, _ = _mean_sd(low[each][upper])
    return RunToRun(mean, exactness, lowest, sd, high[each], len(upper[0]), count_distinct(runs))


def _of_some_pairs(
    sets: npt.NDArray[np.float64], classes: npt.NDArray[np.int64], n_distinct: int, n_pair: int, mapper: Mapper
) -> RunToRun:
    pairs = list(combinations(range(len(sets)), 2))
    chosen = np.random.default_rng(_SEED).choice(len(pairs), n_pair, replace=False)
    drawn = [pairs[i] for i in sorted(chosen)]
    different = [(i, j) for i, j in drawn if classes[i] != classes[j]]
    found = dict(zip(different, mapper(_between, [(sets[i], sets[j]) for i, j in different]), strict=True))
    high, low = (
        np.array([getattr(found[pair], end) * CM_PER_M if pair in found else 0.0 for pair in drawn])
        for end in ("high", "low")
    )
    mean, sd = _mean_sd(high)
    return RunToRun(mean, "sampled", _mean_sd(low)[0], sd, None, len(drawn), n_distinct)


def _between(pair: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]) -> Transport:
    return wasserstein1(*pair)


def _mean_sd(pairs: npt.NDArray[np.float64]) -> tuple[float, float | None]:
    # Measured from the first pair, so that equal pairs give exactly that value and deviation zero.
    offset = pairs - pairs[0]
    return float(pairs[0] + offset.mean()), float(offset.std(ddof=1)) if len(pairs) > 1 else None


@dataclass(frozen=True)
class Gap:
    """Distance between simulated and real outcomes.

    value_cm         W1 between all simulated and all real points [cm]; the upper bound where there
                     are bounds
    exactness        "exact": the optimum up to float64 rounding; "certified": between bounds
    method           the solver that produced it
    extension        what goes beyond the published definition; None where nothing does
    low_cm           lower bound [cm]; the value where it is exact
    """

    value_cm: float
    exactness: str
    method: str
    extension: str | None
    low_cm: float


def sim_to_real_gap(simulated: npt.ArrayLike, real: npt.ArrayLike) -> Gap:
    """Sim-to-real gap of one run (GPUSimBench definition).

        W1 between the n_env * n_item simulated points and the n_trial * n_item real points

    The published definition assigns one to one, hence n_env = n_trial; other counts are solved as
    weighted transport and the result says so.

    Args:
        simulated: planar item positions [m], relative to each env's own origin, shape
            [n_env, n_item, 2].
        real: planar item positions [m] in the same frame, shape [n_trial, n_item, 2].

    Raises:
        ValueError: different item counts, or positions that are empty, not planar or not finite.
    """
    simulated = planar_array(simulated, "simulated", ndim=3)
    real = planar_array(real, "real", ndim=3)
    if simulated.shape[1] != real.shape[1]:
        raise ValueError(
            f"different scenes: {simulated.shape[1]} simulated items per env, {real.shape[1]} real items per trial"
        )
    transport = wasserstein1(simulated.reshape(-1, 2), real.reshape(-1, 2))
    return Gap(
        value_cm=transport.value * CM_PER_M,
        exactness=transport.exactness,
        method=transport.method,
        extension=transport.extension,
        low_cm=transport.low * CM_PER_M,
    )


@dataclass(frozen=True)
class GapTo:
    """The gap between a run and these real positions [m], shape [n_trial, n_item, 2]."""

    real: npt.NDArray[np.float64]

    def __call__(self, simulated: npt.NDArray[np.float64]) -> Gap:
        """The gap of a run, positions [m] as `sim_to_real_gap` takes them."""
        return sim_to_real_gap(simulated, self.real)
