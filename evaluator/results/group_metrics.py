"""The metrics of one group of runs: what each is computed from, and why one cannot be.

The formulas are in ``evaluator.metrics`` and ``evaluator.statistics``; here the runs are turned into their arguments.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.mapping import Mapper
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.alignment import GapTo
from gpusimbench.evaluator.metrics.board import left_board as lost
from gpusimbench.evaluator.metrics.regime import PRESENT_FROM_CM, published_regime
from gpusimbench.evaluator.metrics.variability import (
    CM_PER_M,
    MATRIX_ENVS,
    SAMPLED_ENVS,
    parallel_variability,
    run_to_run_variability,
)
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.results.aggregate import NO_RUN, Runs, differ, ends_of, mean_over_runs
from gpusimbench.evaluator.results.result import Metric, Reference, not_computed
from gpusimbench.evaluator.results.sampled import no_positions
from gpusimbench.evaluator.statistics.energy import energy_distance
from gpusimbench.evaluator.statistics.jackknife import jackknife_pair_mean
from gpusimbench.evaluator.statistics.permutation import permutation_floor
from gpusimbench.evaluator.statistics.regimes import MIN_RUNS, regime_probabilities

_SEED = 0

_PERMUTATIONS = ((1000, 99), (2000, 19))
"""Permutations by the number of points a side: one distance costs about n^2.5, and a table should take seconds."""

_ENERGY_PERMUTATIONS = 999
_ENERGY_POINTS = 20_000
"""Of both sides: their distances are some four seconds of computing."""


def parallel(planar: NDArray[np.float64] | None, why_not: str, work: Work) -> tuple[Metric, NDArray[np.float64] | None]:
    """Parallel variability: mean over runs of the mean W1 over pairs of environments, with the first run's matrix."""
    name = "w1_parallel"
    if planar is None:
        return not_computed(name, "cm", "lower", why_not), None
    if planar.shape[1] < 2:
        return not_computed(name, "cm", "lower", "needs at least two environments"), None
    distinct = {run.tobytes(): run for run in planar}  # identical runs are solved once
    if planar.shape[1] > MATRIX_ENVS:
        solved = [parallel_variability(run, work.map) for run in distinct.values()]
    else:
        solved = work.map(parallel_variability, distinct.values())
    by_run = dict(zip(distinct, solved, strict=True))
    found = [by_run[run.tobytes()] for run in planar]
    metric = mean_over_runs(
        name,
        "cm",
        "lower",
        [f.mean_cm for f in found],
        method="W1 between the planar positions of two environments, mean over pairs, mean over runs",
        extra={"distinct_at_sample_step": [f.n_distinct for f in found]},
    )
    sampled = [f for f in found if f.exactness == "sampled"]
    if sampled:
        metric.extra["sampled"] = {
            "envs": SAMPLED_ENVS,
            "seed": sampled[0].seed,
            "intervals_cm": [list(f.interval_cm) if f.interval_cm else None for f in found],
        }
        metric = replace(metric, exactness="sampled")
    if found[0].matrix_cm is None:
        metric.extra["no_matrix"] = f"{planar.shape[1]} environments are too many for one (limit: {MATRIX_ENVS})"
    return metric, found[0].matrix_cm


def run_to_run(
    planar: NDArray[np.float64] | None, why_not: str, work: Work
) -> tuple[Metric, NDArray[np.float64] | None]:
    """Run-to-run variability: mean and SD of W1 over pairs of runs, all environments of a run pooled."""
    name = "w1_run_to_run"
    if planar is None:
        return not_computed(name, "cm", "lower", why_not), None
    runs = len(planar)
    if runs < 2:
        return not_computed(name, "cm", "lower", "needs at least two complete runs"), None
    try:
        found = run_to_run_variability(planar, work.map)
    except ValueError as error:  # more points than an exact distance can be computed for
        return not_computed(name, "cm", "lower", str(error)), None
    if found.matrix_cm is None:
        bounds, method, no_interval = None, "", f"{found.n_pair} pairs of runs were drawn with seed {found.seed}"
    else:
        interval = jackknife_pair_mean(found.matrix_cm)
        pairs = found.matrix_cm[np.triu_indices(runs, k=1)]
        bounds, no_interval = ends_of(interval, runs, spread=differ(pairs))
        method = f"; interval: {interval.method}"
    metric = Metric(
        name,
        found.mean_cm,
        "cm",
        "lower",
        n=found.n_pair,
        sd=found.sd_cm,
        ci95=bounds,
        method=f"W1 between the pooled planar positions of two runs, mean and SD over pairs of runs{method}",
        exactness=found.exactness,
        extra={"n_run": runs, "interval_why_not": no_interval, "floor": work.once(floor, planar[0], planar[1])},
    )
    if found.exactness != "exact":
        metric.extra["bounds_cm"] = [found.low_cm, found.mean_cm]
    return metric, found.matrix_cm


def real(
    planar: NDArray[np.float64] | None,
    why_not: str,
    reference: Reference | None,
    no_reference: str,
    scene: str,
    work: Work,
) -> Metric:
    """Gap to the reference: mean and SD over runs of W1 between all positions of a run and all of the reference."""
    name = "w1_real"
    if reference is None:
        return not_computed(name, "cm", "lower", no_reference)
    if planar is None:
        return not_computed(name, "cm", "lower", why_not)
    if reference.scene != scene:
        return not_computed(name, "cm", "lower", f"the reference is of scene {reference.scene}")
    if planar.shape[2] != reference.positions.shape[1]:
        why = f"the reference has {reference.positions.shape[1]} items, this group {planar.shape[2]}"
        return not_computed(name, "cm", "lower", why)
    distinct = {run.tobytes(): run for run in planar}
    try:
        gaps = dict(zip(distinct, work.map(GapTo(reference.positions), distinct.values()), strict=True))
    except ValueError as error:  # more points than an exact distance can be computed for
        return not_computed(name, "cm", "lower", str(error))
    found = [gaps[run.tobytes()] for run in planar]
    extra: dict[str, Any] = {
        "reference": reference.label,
        "measured": reference.measured,
        "floor": work.once(floor, planar[0], reference.positions),
    }
    if found[0].extension:
        extra["extension"] = found[0].extension
    method = f"W1 between the planar positions of a run and {reference.label}, mean over runs ({found[0].method})"
    metric = mean_over_runs(name, "cm", "lower", [f.value_cm for f in found], method=method, extra=extra)
    if all(f.exactness == "exact" for f in found):
        return metric
    metric.extra["bounds_cm"] = [float(np.mean([f.low_cm for f in found])), metric.value]
    return replace(metric, exactness="certified")


def left_board(runs: Runs) -> Metric:
    """Mean number of cubes per environment that are not on the board at the sample step."""
    name, unit = "left_board", "cubes per env"
    if not runs:
        return not_computed(name, unit, "lower", NO_RUN)
    board = runs[0].board
    if board is None:
        return not_computed(name, unit, "lower", "this scene has no board to leave")
    if why_not := no_positions(runs):
        return not_computed(name, unit, "lower", why_not)
    spatial = [r.positions.spatial for r in runs if r.positions]
    if any(found is None for found in spatial):
        return not_computed(name, unit, "lower", "heights were not recorded")
    left = [lost(found, board) for found in spatial if found is not None]
    counts = [int(np.count_nonzero(run)) for run in left]
    envs = sum(len(run) for run in left)
    return Metric(
        name,
        sum(counts) / envs,
        unit,
        "lower",
        n=envs,
        method="cubes whose centre is beside or below the board at the sample step",
        extra={
            "total": sum(counts),
            "of": sum(run.size for run in left),
            "per_run": counts,
            "envs_with_any": sum(int(run.any(axis=1).sum()) for run in left),
        },
    )


def sank(runs: Runs) -> Metric:
    """Mean number of cubes per environment that went through the floor or the board."""
    name, unit = "sank", "cubes per env"
    found = [r.sunk for r in runs if r.sunk]
    if not found:
        return not_computed(name, unit, "lower", why_missing(runs[0].sunk) if runs else NO_RUN)
    counts = [sum(s.per_env) for s in found]
    envs = sum(len(s.per_env) for s in found)
    return Metric(
        name,
        sum(counts) / envs,
        unit,
        "lower",
        n=envs,
        method="cubes that are wholly beneath a level surface that they went through, at the last captured step",
        extra={
            "total": sum(counts),
            "of": sum(s.cubes * len(s.per_env) for s in found),
            "cubes": found[0].cubes,
            "per_run": counts,
            "last_step": max(s.last_step for s in found),
            "first_step": min((s.first_step for s in found if s.first_step is not None), default=None),
        },
    )


def regime(
    runs: Runs, parallel: Metric, between: Metric, run_matrix: NDArray[np.float64] | None, classes: list[int]
) -> Metric:
    """The published type, 1 to 4, and how sure it is.

    run_matrix  W1 between runs [cm], shape [run, run]
    classes     of the runs by their bits
    """
    name = "regime_published"
    resolution = CM_PER_M * max((r.equality.resolution or 0.0 for r in runs if r.equality), default=0.0)
    if resolution > PRESENT_FROM_CM:
        why = f"environments lie so far apart that positions are stored to {resolution:.2g} cm, coarser than 0.005 cm"
        return not_computed(name, "type", "neither", why)
    for needed in (parallel, between):
        if needed.value is None:
            return not_computed(name, "type", "neither", f"{needed.name} could not be computed: {needed.why_not}")
    assert parallel.value is not None
    assert between.value is not None
    return Metric(
        name,
        float(published_regime(parallel.value, between.value)),
        "type",
        "neither",
        method="variability counts as present where it is nonzero after rounding to 0.01 cm",
        extra=_probabilities(runs, parallel.extra["per_run"], run_matrix, classes),
    )


def _probabilities(
    runs: Runs, per_run: list[float], matrix: NDArray[np.float64] | None, classes: list[int]
) -> dict[str, Any]:
    if len(per_run) < MIN_RUNS:
        return {"probabilities_why_not": f"needs at least {MIN_RUNS} runs"}
    if matrix is None:
        return {"probabilities_why_not": "not all pairs of runs were computed"}
    if len(classes) != len(matrix):
        return {"probabilities_why_not": "the runs cannot be compared by bits"}
    found = regime_probabilities(per_run, matrix, classes, seed=_SEED)
    return {
        "probabilities": list(found.probabilities),
        "runs": found.n_run,
        "decided_by": [runs[at].configuration.run_index for at in found.decided_by],
        "agreement": found.agreement,
        "distinct": len(set(classes)),
        "run_differs_below": found.run_differs_below,
        "parallel_below": found.parallel_below,
        "method": found.method.value,
        "draws": found.n_draw,
        "seed": found.seed,
    }


def floor(a: NDArray[np.float64], b: NDArray[np.float64], mapper: Mapper) -> dict[str, Any]:
    """What W1 and energy distance [cm] are between two samples of one law: whole envs of a and b exchanged at random.

    a, b    planar positions [m], shape [env, item, 2]
    mapper  makes the distances
    """
    if all((side == side[:1]).all() for side in (a, b)):
        why = "the environments of a side are identical: there is nothing to exchange"
        return {"why_not": why, "energy_why_not": why}
    return {**_floor_of_w1(a * CM_PER_M, b * CM_PER_M, mapper), **_energy(a * CM_PER_M, b * CM_PER_M)}


def _floor_of_w1(a: NDArray[np.float64], b: NDArray[np.float64], mapper: Mapper) -> dict[str, Any]:
    points = max(a.shape[0] * a.shape[1], b.shape[0] * b.shape[1])
    permutations = next((count for limit, count in _PERMUTATIONS if points <= limit), None)
    if permutations is None:
        return {"why_not": f"{points} points a side are too many for a permutation test"}
    found = permutation_floor(a, b, n_permutation=permutations, seed=_SEED, mapper=mapper)
    return {
        "observed_cm": found.observed,
        "floor_mean_cm": found.floor_mean,
        "floor_q95_cm": found.floor_q95,
        "p_value": found.p_value,
        "permutations": found.n_permutation,
        "seed": found.seed,
    }


def _energy(a: NDArray[np.float64], b: NDArray[np.float64]) -> dict[str, Any]:
    points = a.shape[0] * a.shape[1] + b.shape[0] * b.shape[1]
    if points > _ENERGY_POINTS:
        return {"energy_why_not": f"{points} points are too many for their energy distance"}
    found = energy_distance(a, b, n_permutation=_ENERGY_PERMUTATIONS, seed=_SEED)
    return {
        "energy_cm": found.v_statistic,
        "energy_unbiased_cm": found.u_statistic,
        "energy_floor_mean_cm": found.floor_mean,
        "energy_p_value": found.p_value,
        "energy_permutations": found.n_permutation,
    }
