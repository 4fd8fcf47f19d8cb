"""The metrics of one group of runs: what each is computed from, and why one cannot be.

The formulas are in ``evaluator.metrics`` and ``evaluator.statistics``; here the runs are turned into their arguments.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluator.metrics.alignment import sim_to_real_gap
from evaluator.metrics.board import left_board as has_left
from evaluator.metrics.identity import bitwise_classes, count_distinct
from evaluator.metrics.regime import published_regime
from evaluator.metrics.variability import CM_PER_M, MATRIX_ENVS, parallel_variability, run_to_run_variability
from evaluator.over_runs import NO_RUN, Runs, ends_of, mean_over_runs
from evaluator.results import Metric, Reference, not_computed
from evaluator.run_data import RunData
from evaluator.statistics.jackknife import jackknife_pair_mean
from evaluator.statistics.permutation import permutation_floor

_SEED = 0

_PERMUTATIONS = ((1000, 99), (2000, 19))
"""Permutations by the number of points a side: one distance costs about n^2.5, and a table should take seconds."""


def distinct(runs: Runs) -> tuple[Metric, Metric]:
    """Bitwise distinct environments and runs, over every step of the capture phase."""
    captured = [r.captured for r in runs if r.captured is not None]
    if not captured:
        why = "no states were captured" if runs else NO_RUN
        return not_computed("distinct_envs", "", "neither", why), not_computed("distinct_runs", "", "neither", why)
    method = "64-bit state hashes of every captured step"
    return _distinct_envs(runs, method), _distinct_runs(runs, method)


def _distinct_envs(runs: Runs, method: str) -> Metric:
    if runs[0].recording.action_names:
        why = "the environments were given different actions, so they differ by design"
        return not_computed("distinct_envs", "", "neither", why)
    simulation = runs[0].recording.simulation
    if simulation and len(set(simulation.env_origins)) > 1:
        why = "environments at different origins cannot be compared by bits"
        return not_computed("distinct_envs", "", "neither", why)
    captured = [r.captured for r in runs if r.captured is not None]
    counts = [count_distinct(c.hashes.T) for c in captured]
    first = [_first_step(c.steps, (c.hashes != c.hashes[:, :1]).any(axis=1)) for c in captured]
    return Metric(
        "distinct_envs",
        float(max(counts)),
        "",
        "neither",
        method=f"largest number of distinct environments in a run, by {method}",
        n=captured[0].hashes.shape[1],
        extra={
            "per_run": counts,
            "classes": [bitwise_classes(c.hashes.T).tolist() for c in captured],
            "first_difference_step": min((step for step in first if step is not None), default=None),
        },
    )


def _distinct_runs(runs: Runs, method: str) -> Metric:
    captured = [r.captured for r in runs if r.captured is not None]
    if len(captured) < 2:
        return not_computed("distinct_runs", "", "neither", "needs at least two complete runs")
    if len({c.steps.tobytes() for c in captured}) > 1:
        return not_computed("distinct_runs", "", "neither", "the runs captured different steps")
    stacked = np.stack([c.hashes for c in captured])
    differing = (stacked != stacked[:1]).any(axis=(0, 2))
    return Metric(
        "distinct_runs",
        float(count_distinct(stacked)),
        "",
        "neither",
        method=f"distinct runs, env by env, by {method}",
        n=len(captured),
        extra={
            "classes": bitwise_classes(stacked).tolist(),
            "first_difference_step": _first_step(captured[0].steps, differing),
        },
    )


def _first_step(steps: NDArray[np.int64], differing: NDArray[np.bool_]) -> int | None:
    return int(steps[np.argmax(differing)]) if differing.any() else None


def identical_steps(one: Runs, other: Runs) -> int:
    """Number of captured states over which all runs of two groups agree by bits, 0 where they differ anywhere.

    Groups of different scenes, steps, environment counts or layouts are not compared.
    """
    runs = [*one, *other]
    if not (one and other) or len({_comparable(r) for r in runs}) > 1:
        return 0
    captured = [r.captured for r in runs if r.captured is not None]
    if len(captured) < len(runs):
        return 0
    count = min(len(c.steps) for c in captured)
    if len({c.steps[:count].tobytes() for c in captured}) > 1:
        return 0
    return count if count_distinct(np.stack([c.hashes[:count] for c in captured])) == 1 else 0


def _comparable(run: RunData) -> tuple[Any, ...]:
    c, simulation = run.recording.configuration, run.recording.simulation
    scene = simulation.scene.get("sha256") if simulation else None
    return (str(scene), c.n_env, c.dt, c.seed if run.recording.action_names else 0, run.recording.fields)


def capture_effect(runs: Runs) -> Metric:
    """In how many runs the states differ between the timed phase, which nothing observes, and the capture phase."""
    name = "capture_changes_states"
    compared, changed = 0, 0
    for run in runs:
        if run.timed is None or run.captured is None:
            continue
        common, at_timed, at_captured = np.intersect1d(run.timed.steps, run.captured.steps, return_indices=True)
        if not len(common):
            continue
        compared += 1
        changed += bool((run.timed.hashes[at_timed] != run.captured.hashes[at_captured]).any())
    if not compared:
        why = "no step was passed by both the timed and the capture phase" if runs else NO_RUN
        return not_computed(name, "", "lower", why)
    method = "runs whose state hashes differ between timed and capture phase at a step that both passed"
    return Metric(name, float(changed), "", "lower", n=compared, method=method)


def positions(runs: Runs) -> tuple[NDArray[np.float64] | None, str]:
    """Planar positions of all runs [m], [run, env, item, 2]; or None and the reason."""
    if not runs:
        return None, NO_RUN
    why_not = next((r.no_positions for r in runs if r.positions is None), "")
    if why_not:
        return None, why_not
    return np.stack([r.positions.planar for r in runs if r.positions is not None]), ""


def parallel(planar: NDArray[np.float64] | None, why_not: str) -> tuple[Metric, NDArray[np.float64] | None]:
    """Parallel variability: mean over runs of the mean W1 over pairs of environments, with the first run's matrix."""
    name = "w1_parallel"
    if planar is None:
        return not_computed(name, "cm", "lower", why_not), None
    if planar.shape[1] < 2:
        return not_computed(name, "cm", "lower", "needs at least two environments"), None
    solved: dict[bytes, Any] = {}
    found = []
    for run in planar:
        key = run.tobytes()  # identical runs are solved once
        if key not in solved:
            solved[key] = parallel_variability(run)
        found.append(solved[key])
    metric = mean_over_runs(
        name,
        "cm",
        "lower",
        [f.mean_cm for f in found],
        method="W1 between the planar positions of two environments, mean over pairs, mean over runs",
        extra={"distinct_at_sample_step": [f.n_distinct for f in found]},
    )
    if found[0].matrix_cm is None:
        metric.extra["no_matrix"] = f"{planar.shape[1]} environments are too many for one (limit: {MATRIX_ENVS})"
    return metric, found[0].matrix_cm


def run_to_run(planar: NDArray[np.float64] | None, why_not: str) -> tuple[Metric, NDArray[np.float64] | None]:
    """Run-to-run variability: mean and SD of W1 over pairs of runs, all environments of a run pooled."""
    name = "w1_run_to_run"
    if planar is None:
        return not_computed(name, "cm", "lower", why_not), None
    runs = len(planar)
    if runs < 2:
        return not_computed(name, "cm", "lower", "needs at least two complete runs"), None
    try:
        found = run_to_run_variability(planar)
    except ValueError as error:  # more points than an exact distance can be computed for
        return not_computed(name, "cm", "lower", str(error)), None
    interval = jackknife_pair_mean(found.matrix_cm)
    bounds, no_interval = ends_of(interval, runs, spread=bool(found.matrix_cm.any()))
    metric = Metric(
        name,
        found.mean_cm,
        "cm",
        "lower",
        n=runs * (runs - 1) // 2,
        sd=found.sd_cm,
        ci95=bounds,
        method="W1 between the pooled planar positions of two runs, mean and SD over pairs of runs; "
        f"interval: {interval.method}",
        exactness=found.exactness,
        extra={"n_run": runs, "interval_why_not": no_interval, "floor": floor(planar[0], planar[1])},
    )
    if found.exactness == "certified":
        metric.extra["bounds_cm"] = [found.low_cm, found.mean_cm]
    return metric, found.matrix_cm


def real(
    planar: NDArray[np.float64] | None, why_not: str, reference: Reference | None, no_reference: str, scene: str
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
    gaps: dict[bytes, Any] = {}
    try:
        for run in planar:
            if run.tobytes() not in gaps:
                gaps[run.tobytes()] = sim_to_real_gap(run, reference.positions)
    except ValueError as error:  # more points than an exact distance can be computed for
        return not_computed(name, "cm", "lower", str(error))
    found = [gaps[run.tobytes()] for run in planar]
    extra: dict[str, Any] = {
        "reference": reference.label,
        "measured": reference.measured,
        "floor": floor(planar[0], reference.positions),
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
    counts, cubes, envs = [], 0, 0
    for run in runs:
        if run.board is None:
            return not_computed(name, unit, "lower", "this scene has no board to leave")
        if run.positions is None:
            return not_computed(name, unit, "lower", run.no_positions)
        if run.positions.spatial is None:
            return not_computed(name, unit, "lower", "heights were not recorded")
        left = has_left(run.positions.spatial, run.board)
        counts.append(int(left.sum()))
        cubes += left.size
        envs += len(left)
    return Metric(
        name,
        sum(counts) / envs,
        unit,
        "lower",
        n=envs,
        method="cubes whose centre is beside or below the board at the sample step",
        extra={"total": sum(counts), "of": cubes, "per_run": counts},
    )


def sank(runs: Runs) -> Metric:
    """Mean number of cubes per environment that went through the floor or the board."""
    name, unit = "sank", "cubes per env"
    why_not = next((r.no_sunk for r in runs if r.sunk is None), "") if runs else NO_RUN
    if why_not:
        return not_computed(name, unit, "lower", why_not)
    found = [r.sunk for r in runs if r.sunk is not None]
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


def regime(parallel: Metric, between: Metric) -> Metric:
    """The published type, 1 to 4."""
    name = "regime_published"
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
    )


def floor(a: NDArray[np.float64], b: NDArray[np.float64]) -> dict[str, Any]:
    """What W1 [cm] is between two samples of one law: whole environments of a and b exchanged at random.

    a, b  planar positions [m], shape [env, item, 2]
    """
    points = max(a.shape[0] * a.shape[1], b.shape[0] * b.shape[1])
    permutations = next((count for limit, count in _PERMUTATIONS if points <= limit), None)
    if permutations is None:
        return {"why_not": f"{points} points a side are too many for a permutation test"}
    found = permutation_floor(a * CM_PER_M, b * CM_PER_M, n_permutation=permutations, seed=_SEED)
    return {
        "observed_cm": found.observed,
        "floor_mean_cm": found.floor_mean,
        "floor_q95_cm": found.floor_q95,
        "p_value": found.p_value,
        "permutations": found.n_permutation,
        "seed": found.seed,
    }
