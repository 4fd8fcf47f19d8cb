"""What the runs of a group have in common by bits, and how they come apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.divergence import FIT_LIMIT_M
from gpusimbench.evaluator.metrics.identity import changes, distinct_over_time
from gpusimbench.evaluator.metrics.levels import Verdict, verdict
from gpusimbench.evaluator.metrics.split_tree import split_tree
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.results.aggregate import NO_RUN, Runs, mean_over_runs
from gpusimbench.evaluator.results.result import Metric, not_computed
from gpusimbench.evaluator.results.sampled import no_positions
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.state_hashes import Histories, side_by_side

_MM_PER_M = 1000.0
_LEVELS = "0 bit-identical, 1 equal up to order of envs or bodies, 2 within k ULP, 3 within tolerance, 4 different"


def distinct(runs: Runs) -> tuple[Metric, Metric]:
    """Bitwise distinct environments and runs, over every step of the capture phase."""
    if not any(r.histories for r in runs):
        why = "no states were captured" if runs else NO_RUN
        return not_computed("distinct_envs", "", "neither", why), not_computed("distinct_runs", "", "neither", why)
    method = "64-bit state hashes of every captured step"
    return _distinct_envs(runs, method), _distinct_runs(runs, method)


def _distinct_envs(runs: Runs, method: str) -> Metric:
    if runs[0].action_names:
        why = "the environments were given different actions, so they differ by design"
        return not_computed("distinct_envs", "", "neither", why)
    simulation = runs[0].simulation
    if simulation and len(set(simulation.env_origins)) > 1:
        why = "environments at different origins cannot be compared by bits"
        return not_computed("distinct_envs", "", "neither", why)
    found = [r.histories for r in runs if r.histories]
    counts = [h.n_distinct for h in found]
    return Metric(
        "distinct_envs",
        float(max(counts)),
        "",
        "neither",
        method=f"largest number of distinct environments in a run, by {method}",
        n=len(found[0].classes),
        extra={
            "per_run": counts,
            "classes": [h.classes.tolist() for h in found],
            "first_difference_step": min((h.first_step for h in found if h.first_step is not None), default=None),
            "over_time": _most_distinct(found),
            "tree": found[0].tree,
            **_without_hashes(runs),
        },
    )


def _without_hashes(runs: Runs) -> dict[str, int]:
    # complete runs of which nothing is known by bits; evaluator.results.claims makes no claim of all runs then
    without = sum(not r.histories for r in runs)
    return {"without_hashes": without} if without else {}


def _distinct_runs(runs: Runs, method: str) -> Metric:
    found = [r.histories for r in runs if r.histories]
    if len(found) < 2:
        return not_computed("distinct_runs", "", "neither", "needs at least two complete runs")
    both = side_by_side(found)
    if both is None:
        return not_computed("distinct_runs", "", "neither", "the runs have no captured step in common")
    steps, digests = both
    over_time = distinct_over_time(digests)
    apart = np.flatnonzero(over_time.instant > 1)
    first = int(steps[apart[0]]) if len(apart) else None
    return Metric(
        "distinct_runs",
        float(over_time.classes.max() + 1),
        "",
        "neither",
        method=f"distinct runs, env by env, by {method}",
        n=len(found),
        extra={
            "classes": over_time.classes.tolist(),
            "first_difference_step": first,
            "runs": _indices([r for r in runs if r.histories]),
            "over_time": _over_time(steps, over_time.instant, over_time.histories),
            "tree": split_tree(steps, over_time),
            **_without_hashes(runs),
        },
    )


def classes_of(runs: Runs) -> list[int]:
    """The class of each run by its bits, numbered in order of first appearance; empty where one cannot be compared."""
    found = [r.histories for r in runs if r.histories]
    both = side_by_side(found) if found and len(found) == len(runs) else None
    return [] if both is None else distinct_over_time(both[1]).classes.tolist()


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
    return (str(scene), c.n_env, c.dt, c.seed if run.action_names else 0, run.fields)


def capture_effect(runs: Runs, distinct_runs: Metric) -> Metric:
    """In how many runs the states differ between the timed phase, which nothing observes, and the capture phase.

    Only of an engine that repeats itself, bit for bit, is such a difference the doing of the capture.

    distinct_runs  of the same runs
    """
    name = "capture_changes_states"
    observed = [r.observed for r in runs if not isinstance(r.observed, Missing)]
    if not observed:
        why = "no step was passed by both the timed and the capture phase" if runs else NO_RUN
        return not_computed(name, "", "lower", why)
    changed, of = sum(observed), len(observed)
    if changed and distinct_runs.value != 1:
        why = (
            f"{distinct_runs.value:.0f} of {distinct_runs.n} runs are distinct"
            if distinct_runs.value
            else f"nothing shows that runs repeat themselves ({distinct_runs.why_not})"
        )
        missing = not_computed(
            name, "", "lower",
            f"cannot be told: timed and captured states differ in {changed} of {of} runs, but {why}, so they may "
            "differ anyway",
        )  # fmt: skip
        return replace(missing, extra={"differ": changed, "of": of})
    method = "runs whose state hashes differ between timed and capture phase at a step that both passed"
    return Metric(name, float(changed), "", "lower", n=of, method=method)


def equality_of_envs(runs: Runs) -> Metric:
    """How equal the environments of a run are, of the run in which they are least so."""
    name = "equality_envs"
    if why_not := no_positions(runs):
        return not_computed(name, "level", "lower", why_not)
    if runs[0].action_names:
        why = "the environments were given different actions, so they differ by design"
        return not_computed(name, "level", "lower", why)
    found = [r.equality for r in runs if r.equality]
    if not found:
        return not_computed(name, "level", "lower", "needs at least two environments")
    worst = max(range(len(found)), key=lambda index: (found[index].level, _difference(found[index])))
    return _level(name, found[worst], len(found), {"run": runs[worst].configuration.run_index})


def equality_of_runs(runs: Runs) -> Metric:
    """How equal the runs are, environment by environment."""
    name = "equality_runs"
    if why_not := no_positions(runs):
        return not_computed(name, "level", "lower", why_not)
    if len(runs) < 2:
        return not_computed(name, "level", "lower", "needs at least two complete runs")
    classes = classes_of(runs)
    agree = len(set(classes)) == 1 if classes else None
    samples = np.stack([r.positions.recorded for r in runs if r.positions])
    try:
        found = verdict(samples, hashes_agree=agree)
    except ValueError as error:
        return not_computed(name, "level", "lower", str(error))
    return _level(name, found, len(runs), {})


def growth(runs: Runs) -> Metric:
    """Rate at which the largest distance between environments grows while it is small."""
    name, unit = "divergence_rate", "1/s"
    if not runs:
        return not_computed(name, unit, "lower", NO_RUN)
    fitted = [r.spread.fit for r in runs if r.spread and r.spread.fit]
    if not fitted:
        first = runs[0].spread
        return not_computed(name, unit, "lower", why_missing(first.fit if first else first))
    shown = next(r.spread for r in runs if r.spread and r.spread.fit)
    method = (
        "rate of an exponential through the largest distance of a body from environment 0, from the first that is not "
        f"zero up to {FIT_LIMIT_M * _MM_PER_M:g} mm, mean over runs"
    )
    extra = {
        "doubling_time_s": [fit.doubling_time for fit in fitted],
        "r_squared": [fit.r_squared for fit in fitted],
        "window_s": [[fit.begin, fit.end] for fit in fitted],
        "curve": {"step": shown.steps, "rms_m": shown.rms, "largest_m": shown.largest},
    }
    return mean_over_runs(name, unit, "lower", [fit.rate for fit in fitted], method=method, extra=extra)


def _over_time(
    steps: NDArray[np.int64], instant: NDArray[np.int64], histories: NDArray[np.int64]
) -> dict[str, list[int]]:
    # where either count changes
    rows = changes(instant, histories)
    return {"step": steps[rows].tolist(), "at_step": instant[rows].tolist(), "histories": histories[rows].tolist()}


def _most_distinct(found: Sequence[Histories]) -> dict[str, list[int]]:
    # of the run with the most environments that differ
    most = max(found, key=lambda h: h.n_distinct)
    return _over_time(most.steps, most.at_step, most.so_far)


def _indices(runs: Runs) -> list[int]:
    return [r.configuration.run_index for r in runs]


def _difference(found: Verdict) -> float:
    return found.worst.difference if found.worst else 0.0


def _level(name: str, found: Verdict, n: int, extra: dict[str, Any]) -> Metric:
    worst = found.worst
    return Metric(
        name,
        float(found.level),
        "level",
        "lower",
        method=f"level of equality at the sample step, and of all state hashes: {_LEVELS}",
        n=n,
        extra={
            "text": found.text,
            "note": found.note,
            "order": found.order,
            "max_ulp": found.max_ulp,
            "tolerance_m": found.tolerance,
            "worst_ulp": found.worst_ulp,
            "worst": vars(worst) if worst else None,
            **extra,
        },
    )
