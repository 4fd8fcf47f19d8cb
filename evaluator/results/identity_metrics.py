"""What the runs of a group have in common by bits, and how they come apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M, MIN_R_SQUARED
from gpusimbench.evaluator.metrics.identity import changes, distinct_over_time, split_tree
from gpusimbench.evaluator.metrics.levels import AxisVerdict, verdict
from gpusimbench.evaluator.missing import Claim, Missing, why_missing
from gpusimbench.evaluator.results.details import (
    AngleCurve,
    Changed,
    DistinctEnvs,
    DistinctRuns,
    Equality,
    Growth,
    OverTime,
    SpreadCurve,
)
from gpusimbench.evaluator.results.group_runs import NO_RUN, GroupRuns, Runs, no_positions
from gpusimbench.evaluator.results.metric import Direction, Estimate, Metric, Table, each, missing
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.state_hashes import Histories, side_by_side
from gpusimbench.schemas.configuration import deciding

_MM_PER_M = 1000.0
_HASHED = "64-bit state hashes of every captured step"
_HASHED_ENDS = "64-bit state hashes of the first and the last timed step"
_TIMED = (
    "If no run captured states, the states at the first and at the last step of the timed phase are compared (answers "
    'then end with "timed")'
)


def hashed_by(runs: Runs) -> tuple[list[tuple[Run, Histories]], bool]:
    """Runs that are compared by bits, with their states, and whether these are of the timed phase.

    They are where no run captured states: a state of the timed phase says nothing of a captured state.
    """
    captured = [(r, r.histories) for r in runs if r.histories]
    return (captured, False) if captured else ([(r, r.timed_histories) for r in runs if r.timed_histories], True)


def _no_hashes(runs: Runs) -> str:
    if hashed_by(runs)[0]:
        return ""
    return why_missing(runs[0].histories) if runs else NO_RUN


def _method(metric: Metric, *, timed: bool) -> str:
    return metric.method.replace(_HASHED, _HASHED_ENDS) if timed else metric.method


def _steps(found: Sequence[Histories]) -> tuple[int, ...]:
    return tuple(np.unique(np.concatenate([h.steps for h in found])).tolist())


def _distinct_envs(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    runs = group.runs
    if why_not := _no_hashes(runs):
        return Missing(why_not)
    if runs[0].apart_by_design:
        return Missing(runs[0].apart_by_design)
    simulation = runs[0].simulation
    if simulation and len(set(simulation.env_origins)) > 1:
        return Missing("environments at different origins cannot be compared by bits")
    compared, timed = hashed_by(runs)
    found = [h for _, h in compared]
    counts = tuple(h.n_distinct for h in found)
    return Estimate(
        metric,
        float(max(counts)),
        method=_method(metric, timed=timed),
        n=len(found[0].classes),
        details=DistinctEnvs(
            per_run=counts,
            # two steps of the timed phase do not say when environments parted, and there may be 100,000 of these
            classes=() if timed else tuple(tuple(h.classes.tolist()) for h in found),
            first_difference_step=None
            if timed
            else min((h.first_step for h in found if h.first_step is not None), default=None),
            over_time=None if timed else _most_distinct(found),
            tree=None if timed else found[0].tree,
            without_hashes=len(runs) - len(found) or None,
            timed_steps=_steps(found) if timed else None,
        ),
    )


def _distinct_runs(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    runs = group.runs
    if why_not := _no_hashes(runs):
        return Missing(why_not)
    compared, timed = hashed_by(runs)
    found = [h for _, h in compared]
    if len(found) < 2:
        return Missing("needs at least two complete runs")
    both = side_by_side(found)
    if both is None:
        return Missing("the runs have no hashed step in common")
    steps, digests = both
    over_time = distinct_over_time(digests)
    apart = np.flatnonzero(over_time.instant > 1)
    return Estimate(
        metric,
        float(over_time.classes.max() + 1),
        method=_method(metric, timed=timed),
        n=len(found),
        details=DistinctRuns(
            classes=tuple(over_time.classes.tolist()),
            first_difference_step=int(steps[apart[0]]) if len(apart) and not timed else None,
            run_indices=tuple(r.configuration.run_index for r, _ in compared),
            over_time=None if timed else _over_time(steps, over_time.instant, over_time.histories),
            tree=None if timed else split_tree(steps, over_time),
            without_hashes=len(runs) - len(found) or None,
            timed_steps=_steps(found) if timed else None,
        ),
    )


def identical(estimate: Estimate) -> Claim:
    """Whether all that an estimate of distinct environments or runs is about has the same bits.

    One environment or run is compared with nothing; runs without state hashes are named by the estimate, and where
    those that have them agree, nothing is known of all.
    """
    if isinstance(estimate.value, Missing):
        return Claim(None, estimate.value.reason)
    if estimate.n < 2:
        return Claim(None, "only one was recorded")
    if estimate.value != 1:
        return Claim(False)
    details = estimate.details
    without = details.without_hashes if isinstance(details, DistinctEnvs | DistinctRuns) else None
    if without:
        return Claim(None, f"{without} complete run{'s have' if without > 1 else ' has'} no state hashes")
    return Claim(True)


def identical_steps(one: Runs, other: Runs) -> int:
    """Number of captured states over which all runs of two groups agree by bits, 0 where they differ anywhere.

    Groups of different scenes, steps, environment counts or layouts are not compared.
    """
    runs = [*one, *other]
    if not (one and other) or len({comparable(r) for r in runs}) > 1:
        return 0
    found = [r.histories for r in runs if r.histories]
    if len(found) < len(runs):
        return 0
    count = min(len(h.steps) for h in found)
    return count if len({h.until(count) for h in found}) == 1 else 0


def comparable(run: Run) -> tuple[Any, ...]:
    """What two runs must have in common for their states to be compared by bits."""
    c, simulation = run.configuration, run.simulation
    scene = simulation.scene.get("sha256") if simulation else None
    seed = c.seed if run.apart_by_design else 0
    return (str(scene), c.n_env, c.dt, seed, deciding(c.settings), run.fields)


def _capture_effect(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    """In how many runs the states differ between the timed phase, which nothing observes, and the capture phase.

    Only of an engine that repeats itself, bit for bit, is such a difference the doing of the capture.
    """
    observed = [r.observed for r in group.runs if not isinstance(r.observed, Missing)]
    if not observed:
        return Missing("no step was passed by both the timed and the capture phase" if group.runs else NO_RUN)
    changed, of = sum(observed), len(observed)
    runs = DISTINCT_RUNS.estimate(group)
    if changed and runs.value != 1:
        why = (
            f"nothing shows that runs repeat themselves ({runs.value.reason})"
            if isinstance(runs.value, Missing)
            else f"{runs.value:.0f} of {runs.n} runs are distinct"
        )
        return missing(
            metric,
            f"cannot be told: timed and captured states differ in {changed} of {of} runs, but {why}, so they may "
            "differ anyway",
            Changed(changed, of),
        )
    return Estimate(metric, float(changed), n=of, method=metric.method)


def _equality_of_envs(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    """How equal the environments of a run are, of the run in which they are least so."""
    runs = group.at_sample
    if why_not := no_positions(runs):
        return Missing(why_not)
    if runs[0].apart_by_design:
        return Missing(runs[0].apart_by_design)
    found = [r.equality for r in runs if r.equality]
    if not found:
        return Missing("needs at least two environments")
    worst = max(range(len(found)), key=lambda index: (found[index].level, _difference(found[index])))
    return _level(metric, found[worst], len(found), runs[worst].configuration.run_index)


def _equality_of_runs(metric: Metric, group: GroupRuns) -> Estimate | Missing:
    """How equal the runs are, environment by environment."""
    runs = group.at_sample
    if why_not := no_positions(runs):
        return Missing(why_not)
    if len(runs) < 2:
        return Missing("needs at least two complete runs")
    agree = len(set(group.classes)) == 1 if group.classes else None
    samples = np.stack([r.positions.recorded for r in runs if r.positions])
    try:
        found = verdict(samples, hashes_agree=agree)
    except ValueError as error:
        return Missing(str(error))
    return _level(metric, found, len(runs))


def _rate(run: Run) -> float | Missing:
    if isinstance(run.spread, Missing):
        return run.spread
    fit = run.spread.fit
    if isinstance(fit, Missing):
        return fit
    return Missing(fit.why_no_rate) if fit.why_no_rate else fit.rate


def _growth(group: GroupRuns) -> Growth:
    shown = [r.spread for r in group.runs if r.spread and r.spread.fit and not r.spread.fit.why_no_rate]
    fitted = [spread.fit for spread in shown if spread.fit]
    first = shown[0]
    return Growth(
        doubling_time_s=tuple(fit.doubling_time for fit in fitted),
        r_squared=tuple(fit.r_squared for fit in fitted),
        window_s=tuple((fit.begin_s, fit.end_s) for fit in fitted),
        curve=(SpreadCurve if first.unit == "m" else AngleCurve)(
            tuple(first.steps), tuple(first.rms), tuple(first.largest)
        ),
    )


def _over_time(steps: NDArray[np.int64], instant: NDArray[np.int64], histories: NDArray[np.int64]) -> OverTime:
    # where either count changes
    rows = changes(instant, histories)
    return OverTime(tuple(steps[rows].tolist()), tuple(instant[rows].tolist()), tuple(histories[rows].tolist()))


def _most_distinct(found: Sequence[Histories]) -> OverTime:
    # of the run with the most environments that differ
    most = max(found, key=lambda h: h.n_distinct)
    return _over_time(most.steps, most.at_step, most.so_far)


def _difference(found: AxisVerdict) -> float:
    return found.worst.difference if found.worst else 0.0


def _level(metric: Metric, found: AxisVerdict, n: int, run: int | None = None) -> Estimate:
    return Estimate(
        metric,
        float(found.level),
        method=metric.method,
        n=n,
        details=Equality(
            text=found.text,
            note=found.note,
            order=found.order,
            max_ulp=found.max_ulp,
            tolerance_m=found.tolerance,
            worst_ulp=found.worst_ulp,
            worst=found.worst,
            run=run,
        ),
    )


DISTINCT_ENVS = Metric(
    "distinct_envs", "distinct envs", "", Direction.NEITHER,
    "number of classes of environments of a run; environments of a class are bit-identical at every captured step; "
    "largest number of all runs, and their [splits](#divergence) over time. " + _TIMED,
    method=f"largest number of distinct environments in a run, by {_HASHED}",
    table=Table.VARIABILITY, of_group=_distinct_envs,
)  # fmt: skip

DISTINCT_RUNS = Metric(
    "distinct_runs", "distinct runs", "", Direction.NEITHER,
    "number of classes of runs; runs of a class are bit-identical, environment by environment. " + _TIMED,
    method=f"distinct runs, env by env, by {_HASHED}", table=Table.VARIABILITY, of_group=_distinct_runs,
)  # fmt: skip

_LEVELS = (
    "level of equality at the sample step, and of all state hashes: 0 bit-identical, 1 equal up to order of envs or "
    "bodies, 2 within k ULP, 3 within tolerance, 4 different"
)

EQUALITY_ENVS = Metric(
    "equality_envs", "equality of envs", "level", Direction.LOWER,
    "strongest level of equality that holds for the environments of a run, in the run where they are least equal: 0 "
    'bit-identical at every captured step, 1 the same positions with bodies in another order ("equal up to the order '
    'of bodies"), 2 within 8 ULP, 3 within 0.1 mm, 4 different. Levels 1 to 4 refer to positions at the sample step; '
    "the worst pair is given",
    method=_LEVELS, table=Table.VARIABILITY, of_group=_equality_of_envs,
)  # fmt: skip

EQUALITY_RUNS = Metric(
    "equality_runs", "equality of runs", "level", Direction.LOWER,
    "the same levels for runs, environment by environment. Level 1 also if the environments are the same, bit by bit "
    'and each as often, in another order ("equal up to the order of environments", "... environments and bodies"). An '
    "order is not recognised if values also differ by rounding, or if environments have different origins. "
    "Orientations and velocities are not compared ([`gsb-diff`](diff.md) compares them)",
    method=_LEVELS, table=Table.VARIABILITY, of_group=_equality_of_runs,
)  # fmt: skip

DIVERGENCE_RATE = Metric(
    "divergence_rate", "divergence rate of envs", "1/s", Direction.LOWER,
    "rate of an exponential fitted to the largest distance of a body from the same body in environment 0, from the "
    "first nonzero distance up to 1 mm (without bodies, to the largest difference of a hinge, up to 1 mrad). Mean over "
    "runs, with the curve of one run. A run has no rate if R squared of "
    f"its fit is below {MIN_R_SQUARED:g}, or below that of a power of time: [`divergence`](#divergence) has the fit",
    method="rate of an exponential through the largest distance of a body from environment 0, from the first that is "
    f"not zero up to {FIT_LIMIT_M * _MM_PER_M:g} mm",
    table=Table.VARIABILITY, values=each(_rate), details=_growth, optional=True,
)  # fmt: skip

CAPTURE_CHANGES_STATES = Metric(
    "capture_changes_states", "runs changed by capturing", "", Direction.LOWER,
    "number of runs whose captured states differ from the states of the timed phase, in which nothing is recorded. If "
    "some differ, there is a value only if all runs are bit-identical (`distinct_runs` is 1), because otherwise the "
    "engine itself may cause the difference",
    method="runs whose state hashes differ between timed and capture phase at a step that both passed",
    of_group=_capture_effect,
)  # fmt: skip
