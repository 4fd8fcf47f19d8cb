"""Metrics of where the bodies of a group are at the sample step: W1 between environments, runs and to a reference.

Each W1 has a clamped counterpart, in which every cube that left the board is moved to the nearest edge of the board. A
cube that leaves the board falls until the sample step and may be metres away, so a few such cubes decide the mean over
all cubes. The clamped distance does not contain this flight. Both are shown, the published distance first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.lost_cubes import left_board
from gpusimbench.evaluator.metrics.radar import Axis as RadarAxis
from gpusimbench.evaluator.metrics.variability import (
    CM_PER_M,
    MATRIX_ENVS,
    SAMPLED_ENVS,
    GapTo,
    ParallelVariability,
    parallel_variability,
    run_to_run_variability,
)
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.results.details import (
    BetweenEnvs,
    BetweenRuns,
    Details,
    Drawn,
    OffTheBoard,
    OverRuns,
    PublishedType,
    SunkCubes,
    ToReference,
)
from gpusimbench.evaluator.results.group_runs import NO_RUN, GroupRuns, differ, ends_of, no_positions
from gpusimbench.evaluator.results.metric import Axis, Direction, Estimate, Metric, Table, over_runs
from gpusimbench.evaluator.statistics.jackknife import jackknife_pair_mean
from gpusimbench.evaluator.statistics.permutation import floor
from gpusimbench.evaluator.statistics.regimes import (
    MIN_RUNS,
    PRESENT_FROM_CM,
    RegimeProbabilities,
    published_regime,
    regime_probabilities,
)

_SEED = 0


def _solved(group: GroupRuns) -> list[ParallelVariability] | Missing:
    """W1 between environments of every run that recorded the sample step; identical runs are solved once."""
    planar = group.planar
    if isinstance(planar, Missing):
        return planar
    if group.at_sample[0].apart_by_design:
        return Missing(group.at_sample[0].apart_by_design)
    if planar.shape[1] < 2:
        return Missing("needs at least two environments")
    distinct = {run.tobytes(): run for run in planar}
    if planar.shape[1] > MATRIX_ENVS:
        solved = [parallel_variability(run, group.work.map) for run in distinct.values()]
    else:
        solved = group.work.map(parallel_variability, distinct.values())
    by_run = dict(zip(distinct, solved, strict=True))
    return [by_run[run.tobytes()] for run in planar]


def _parallel_values(group: GroupRuns) -> list[float | Missing]:
    """A value of every run; a run that did not record the sample step has none."""
    found = W1_PARALLEL.estimate(group)
    per_run = iter(found.of(BetweenEnvs).per_run or ())
    none = found.value if isinstance(found.value, Missing) else Missing("the sample step was not recorded")
    used = {id(run) for run in group.at_sample}
    return [next(per_run, none) if id(run) in used else none for run in group.runs]


def _parallel(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    found = _solved(group)
    if isinstance(found, Missing):
        return found
    drawn = [f for f in found if f.exactness == "sampled"]
    matrix = found[0].matrix_cm
    n_env = len(group.planar[0]) if not isinstance(group.planar, Missing) else 0
    details = BetweenEnvs(
        distinct_at_sample_step=tuple(f.n_distinct for f in found),
        sampled=Drawn(SAMPLED_ENVS, drawn[0].seed, tuple(f.interval_cm for f in found)) if drawn else None,
        matrix_of=Missing(f"{n_env} environments are too many for one (limit: {MATRIX_ENVS})")
        if matrix is None
        else _place(group),
        matrix_cm=matrix,
    )
    estimate = over_runs(replace(metric, values=lambda _: [f.mean_cm for f in found], details=lambda _: details), group)
    return replace(estimate, metric=metric, exactness="sampled" if drawn else "exact")


def _place(group: GroupRuns) -> int | Missing:
    """Of the run whose matrix is kept, among the runs whose environments are compared by bits."""
    hashed = [run for run in group.runs if run.histories]
    found = next((at for at, run in enumerate(hashed) if run is group.at_sample[0]), None)
    return Missing("its states have no hashes") if found is None else found


def _run_to_run(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    planar = group.planar
    if isinstance(planar, Missing):
        return planar
    runs = len(planar)
    if runs < 2:
        return Missing("needs at least two complete runs")
    try:
        found = run_to_run_variability(planar, group.work.map)
    except ValueError as error:  # more points than an exact distance can be computed for
        return Missing(str(error))
    if found.matrix_cm is None:
        drawn = f"{found.n_pair} pairs of runs were drawn with seed {found.seed}"
        bounds: tuple[float, float] | Missing = Missing(drawn)
        method = ""
    else:
        interval = jackknife_pair_mean(found.matrix_cm)
        pairs = found.matrix_cm[np.triu_indices(runs, k=1)]
        bounds = ends_of(interval, runs, spread=differ(pairs))
        method = f"; interval: {interval.method}"
    kept = found.matrix_cm is not None
    return Estimate(
        metric,
        found.mean_cm,
        n=found.n_pair,
        sd=found.sd_cm,
        ci95=bounds,
        method=f"{metric.method}, mean and SD over pairs of runs{method}",
        exactness=found.exactness,
        details=BetweenRuns(
            n_run=runs,
            permutation_test=group.work.once(floor, planar[0], planar[1]),
            bounds_cm=None if found.exactness == "exact" else (found.low_cm, found.mean_cm),
            run_indices=tuple(r.configuration.run_index for r in group.at_sample) if kept else None,
            classes=group.classes if kept else None,
            matrix_cm=found.matrix_cm,
        ),
    )


def _to_reference(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    reference, planar = group.reference, group.planar
    if isinstance(reference, Missing):
        return reference
    if isinstance(planar, Missing):
        return planar
    if reference.scene != group.scene:
        return Missing(f"the reference is of scene {reference.scene}")
    if planar.shape[2] != reference.positions.shape[1]:
        return Missing(f"the reference has {reference.positions.shape[1]} items, this group {planar.shape[2]}")
    distinct = {run.tobytes(): run for run in planar}
    try:
        gaps = dict(zip(distinct, group.work.map(GapTo(reference.positions), distinct.values()), strict=True))
    except ValueError as error:  # more points than an exact distance can be computed for
        return Missing(str(error))
    found = [gaps[run.tobytes()] for run in planar]
    exact = all(f.exactness == "exact" for f in found)
    details = ToReference(
        reference=reference.label,
        measured=reference.measured,
        permutation_test=group.work.once(floor, planar[0], reference.positions),
        extension=found[0].extension or None,
    )
    measured = replace(
        metric,
        values=lambda _: [f.value_cm for f in found],
        details=lambda _: details,
        remark=f" ({found[0].method})",
    )
    estimate = over_runs(measured, group, f"W1 between the planar positions of a run and {reference.label}")
    estimate = replace(estimate, metric=metric)
    if exact or isinstance(estimate.value, Missing):
        return estimate
    bounds = float(np.mean([f.low_cm for f in found])), estimate.value
    return replace(
        estimate, exactness="certified", details=replace(estimate.of(ToReference), bounds_cm=bounds)
    )  # fmt: skip


def _left_board(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    runs = group.at_sample
    if not runs:
        return Missing(NO_RUN)
    board = runs[0].board
    if board is None:
        return Missing("scene.json names no board (a fixed box) that bodies could leave")
    if why_not := no_positions(runs):
        return Missing(why_not)
    spatial = [r.positions.spatial for r in runs if r.positions]
    if any(found is None for found in spatial):
        return Missing("heights were not recorded")
    left = [left_board(found, board) for found in spatial if found is not None]
    counts = tuple(int(np.count_nonzero(run)) for run in left)
    envs = sum(len(run) for run in left)
    return Estimate(
        metric,
        sum(counts) / envs,
        n=envs,
        method=metric.method,
        details=OffTheBoard(
            total=sum(counts),
            of=sum(run.size for run in left),
            per_run=counts,
            envs_with_any=sum(int(run.any(axis=1).sum()) for run in left),
        ),
    )


def _sank(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    found = [r.sunk for r in group.runs if r.sunk]
    if not found:
        return Missing(why_missing(group.runs[0].sunk) if group.runs else NO_RUN)
    counts = tuple(sum(s.per_env) for s in found)
    envs = sum(len(s.per_env) for s in found)
    return Estimate(
        metric,
        sum(counts) / envs,
        n=envs,
        method=metric.method,
        details=SunkCubes(
            total=sum(counts),
            of=sum(s.cubes * len(s.per_env) for s in found),
            cubes=found[0].cubes,
            per_run=counts,
            last_step=max(s.last_step for s in found),
            first_step=min((s.first_step for s in found if s.first_step is not None), default=None),
        ),
    )


def _regime(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    runs = group.at_sample
    resolution = CM_PER_M * max((r.equality.resolution or 0.0 for r in runs if r.equality), default=0.0)
    if resolution > PRESENT_FROM_CM:
        why = f"environments lie so far apart that positions are stored to {resolution:.2g} cm, coarser than 0.005 cm"
        return Missing(why)
    parallel, between = W1_PARALLEL.estimate(group), W1_RUN_TO_RUN.estimate(group)
    for needed in (parallel, between):
        if isinstance(needed.value, Missing):
            return Missing(f"{needed.name} could not be computed: {needed.value.reason}")
    assert not isinstance(parallel.value, Missing)
    assert not isinstance(between.value, Missing)
    per_run = parallel.of(OverRuns).per_run or ()
    resampled = _resampled(group, per_run, between.of(BetweenRuns).matrix_cm)
    return Estimate(
        metric,
        float(published_regime(parallel.value, between.value)),
        method=metric.method,
        details=PublishedType(resampled),
    )


def _resampled(
    group: GroupRuns, per_run: Sequence[float], matrix: NDArray[np.float64] | None
) -> RegimeProbabilities | Missing:  # fmt: skip
    if len(per_run) < MIN_RUNS:
        return Missing(f"needs at least {MIN_RUNS} runs")
    if matrix is None:
        return Missing("not all pairs of runs were computed")
    if len(group.classes) != len(matrix):
        return Missing("the runs cannot be compared by bits")
    found = regime_probabilities(per_run, matrix, group.classes, seed=_SEED)
    return replace(found, decided_by=tuple(group.at_sample[at].configuration.run_index for at in found.decided_by))


W1_PARALLEL = Metric(
    "w1_parallel", "W1 between envs", "cm", Direction.LOWER,
    "parallel variability: mean of W1 over all pairs of environments of a run; mean over runs",
    method="W1 between the planar positions of two environments, mean over pairs", published=True,
    table=Table.VARIABILITY, values=_parallel_values, of_group=_parallel,
    interval="delete-one-run jackknife", axis=Axis.VARIABILITY, radar=RadarAxis.PARALLEL,
)  # fmt: skip

W1_RUN_TO_RUN = Metric(
    "w1_run_to_run", "W1 between runs", "cm", Direction.LOWER,
    "run-to-run variability: mean and SD of W1 over all pairs of runs, where the bodies of all environments of a run "
    "are one set",
    method="W1 between the pooled planar positions of two runs", published=True,
    table=Table.VARIABILITY, of_group=_run_to_run,
    interval="delete-one-run jackknife of a mean over pairs", axis=Axis.VARIABILITY, radar=RadarAxis.RUN_TO_RUN,
)  # fmt: skip

W1_REAL = Metric(
    "w1_real", "W1 to the reference", "cm", Direction.LOWER,
    "distance to real trials (or to another recording): W1 between all positions of a run and all positions of the "
    "reference; mean over runs",
    method="W1 between the planar positions of a run and the reference", published=True,
    table=Table.VARIABILITY, of_group=_to_reference, interval="delete-one-run jackknife", radar=RadarAxis.EMD_TO_REAL,
)  # fmt: skip

LEFT_BOARD = Metric(
    "left_board", "bodies off the board", "bodies per env", Direction.LOWER,
    "bodies beside or below the board at the sample step; see [cubes that left the board](#cubes-that-left-the-board)",
    method="bodies whose centre is beside or below the board at the sample step",
    table=Table.VARIABILITY, of_group=_left_board,
)  # fmt: skip

SANK = Metric(
    "sank", "bodies sunk", "bodies per env", Direction.LOWER,
    "bodies that went through the board or the ground by the last captured step; see "
    "[through the floor](#through-the-floor)",
    method="bodies that are wholly beneath a level surface that they went through, at the last captured step",
    table=Table.VARIABILITY, of_group=_sank,
)  # fmt: skip

REGIME = Metric(
    "regime_published", "published type", "type", Direction.NEITHER,
    "[type](regimes.md) 1 to 4: whether `w1_parallel` and `w1_run_to_run` are nonzero after rounding to 0.01 cm; with "
    "the probability of each type for another sample of as many runs, or, if all runs agree, a bound on the "
    "probability that another run differs ([statistics](statistics.md#regimes-statisticsregimespy))",
    method="variability counts as present where it is nonzero after rounding to 0.01 cm", published=True,
    table=Table.VARIABILITY, of_group=_regime,
)  # fmt: skip


SUFFIX = "_clamped"
"""Of the name: "w1_parallel_clamped" stands beside "w1_parallel"."""

_AT_EDGE = "; positions beside the board are put at its nearest edge"


def _clamped(published: Metric) -> Metric:
    """The counterpart of a metric, which has its very value where no position is beside the board."""

    def estimate(metric: Metric, group: GroupRuns) -> Estimate | Missing:
        found, board = published.estimate(group), group.on_board
        if isinstance(found.value, Missing):
            return found.value
        if isinstance(board, Missing):
            return board
        beside = board.planar is not group.planar or (published is W1_REAL and board.reference is not group.reference)
        if beside:
            found = published.estimate(board)
            found = replace(found, details=_without_matrix(found.details))
        return replace(found, metric=metric, method=found.method + _AT_EDGE)

    return replace(
        published,
        name=published.name + SUFFIX,
        title=f"clamped {published.title}",
        docs=f"`{published.name}` with every position beside the board [moved to its nearest "
        "edge](#cubes-that-left-the-board)",
        published=False,
        values=None,
        of_group=estimate,
        optional=True,
        axis=None,
        radar=None,
    )


def _without_matrix(details: Details) -> Details:
    # the matrices that are kept are those of the published values
    if isinstance(details, BetweenEnvs):
        return replace(details, matrix_of=None, matrix_cm=None)
    if isinstance(details, BetweenRuns):
        return replace(details, run_indices=None, classes=None, matrix_cm=None)
    return details


CLAMPED = tuple(_clamped(metric) for metric in (W1_PARALLEL, W1_RUN_TO_RUN, W1_REAL))
"""The clamped counterparts of W1 between environments, between runs and to the reference."""
