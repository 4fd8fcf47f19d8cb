"""The metrics of one group of recordings: what each is computed from, and why one cannot be.

The formulas are in ``evaluator.metrics``; here recordings are turned into their arguments.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluator.groups import Group
from evaluator.metrics.alignment import sim_to_real_gap
from evaluator.metrics.board import left_board as count_left_board
from evaluator.metrics.identity import bitwise_classes, count_distinct
from evaluator.metrics.memory import Checkpoints
from evaluator.metrics.regime import published_regime
from evaluator.metrics.throughput import frames_per_second
from evaluator.metrics.variability import parallel_variability, run_to_run_variability
from evaluator.positions import planar_positions, sampled_positions
from evaluator.recording import MemoryTrace
from evaluator.results import Metric, Reference, not_computed
from evaluator.statistics.jackknife import Interval, jackknife_mean, jackknife_pair_mean
from evaluator.statistics.permutation import permutation_floor
from schemas.errors import DamagedRecording

_PERMUTATIONS = 99
_SEED = 0
_GB = 1e9
_MB = 1e6


@dataclass(frozen=True)
class Sample:
    """A group's positions at the sample step.

    positions  planar, env frame [m], [run, env, item, 2]; None where no run has them
    recorded   as recorded, one [env, item, component] a run
    why_not    the reason where positions is None
    """

    positions: NDArray[np.float64] | None
    recorded: tuple[NDArray[Any], ...]
    why_not: str


def status_notes(group: Group) -> list[str]:
    """What a reader must know of runs that no metric is computed from."""
    notes = []
    for recording in group.recordings:
        if recording.status != "complete":
            notes.append(f"run {recording.configuration.run_index} is {recording.status}: {recording.reason}")
        notes += [f"run {recording.configuration.run_index} lost data: {lost}" for lost in recording.dropouts]
    return notes


def sample(group: Group, sample_time: float) -> Sample:
    """The positions of all complete runs at the sample step."""
    if not group.complete:
        return Sample(None, (), "no run of this group is complete")
    planar, recorded = [], []
    for recording in group.complete:
        positions, why_not = planar_positions(recording, sample_time)
        if positions is None:
            return Sample(None, (), why_not)
        as_recorded, _ = sampled_positions(recording, sample_time)
        assert as_recorded is not None
        planar.append(positions)
        recorded.append(as_recorded)
    return Sample(np.stack(planar), tuple(recorded), "")


def throughput(group: Group) -> Metric:
    """FPS: mean over runs of N_env * N_step / T_step of the timed phase."""
    name, unit = "fps", "env-steps/s"
    timings = [(r, r.timing.get("timed")) for r in group.complete]
    values = [
        frames_per_second(r.configuration.n_env, r.configuration.timed_steps, t.elapsed_s) for r, t in timings if t
    ]
    if not values:
        why = "no run of this group is complete" if not timings else "the timed phase was left out"
        return not_computed(name, unit, "higher", why)
    simulation = group.complete[0].simulation
    return _mean_over_runs(
        name, unit, "higher", values,
        method="N_env * N_step / T_step of the timed phase, mean over runs",
        extra={"per_run": values, "timing_covers": simulation.timing_covers if simulation else ""},
    )  # fmt: skip


def memory_peak_increment(group: Group) -> Metric:
    """GPU memory: largest reading of the timed phase minus the baseline, as the hardware monitor reports it."""
    name, unit = "memory_peak_increment", "GB"
    if not group.complete:
        return not_computed(name, unit, "lower", "no run of this group is complete")
    first = group.complete[0]
    if not first.provenance.gpus:
        return not_computed(name, unit, "lower", "no GPU on the machine that recorded")
    if first.simulation and first.simulation.device == "cpu":
        return not_computed(name, unit, "lower", "this simulator ran on the CPU")
    return _memory(group, "gpu0/device", name, unit, _GB, "NVML, whole device")


def host_memory_peak_increment(group: Group) -> Metric:
    """Host memory: largest resident set of the timed phase minus the baseline."""
    name, unit = "host_memory_peak_increment", "MB"
    if not group.complete:
        return not_computed(name, unit, "lower", "no run of this group is complete")
    return _memory(group, "host", name, unit, _MB, "resident set of the run's process")


def _memory(group: Group, source: str, name: str, unit: str, scale: float, monitor: str) -> Metric:
    checkpoints = [_checkpoints(r.memory[source]) for r in group.complete if source in r.memory]
    values = [c.peak_increment / scale for c in checkpoints if c.peak_increment is not None]
    if not values:
        return not_computed(name, unit, "lower", "the timed phase was left out, or no memory was sampled in it")
    return _mean_over_runs(
        name, unit, "lower", values,
        method=f"peak of the timed phase minus baseline ({monitor}), mean over runs; 1 {unit} = {scale:.0e} B",
        extra={"per_run": values, "checkpoints_bytes": [vars(c) for c in checkpoints]},
    )  # fmt: skip


def _checkpoints(trace: MemoryTrace) -> Checkpoints:
    baseline, final = trace.at("baseline"), trace.at("final")
    peak = trace.peak("timed")
    if peak is not None and baseline is not None:
        peak = max(peak, baseline)  # a monitor of a whole device also sees others release memory
    return Checkpoints(baseline, trace.at("post-init"), trace.at("post-warmup"), peak, final)


def distinct(group: Group) -> tuple[Metric, Metric]:
    """Bitwise distinct environments and runs, over every step of the capture phase."""
    hashes = [f.hashes for r in group.complete if (f := r.fingerprints("capture")) is not None]
    if not hashes:
        why = "no run of this group is complete" if not group.complete else "no states were captured"
        return (
            not_computed("distinct_envs", "", "neither", why),
            not_computed("distinct_runs", "", "neither", why),
        )
    method = "64-bit state hashes of every captured step"
    return _distinct_envs(group, hashes, method), _distinct_runs(hashes, method)


def _distinct_envs(group: Group, hashes: list[NDArray[np.uint64]], method: str) -> Metric:
    if group.complete[0].action_names:
        why = "the environments were given different actions, so they differ by design"
        return not_computed("distinct_envs", "", "neither", why)
    simulation = group.complete[0].simulation
    if simulation and len(set(simulation.env_origins)) > 1:
        why = "environments at different origins cannot be compared by bits"
        return not_computed("distinct_envs", "", "neither", why)
    counts = [count_distinct(h.T) for h in hashes]
    classes = [bitwise_classes(h.T).tolist() for h in hashes]
    return Metric(
        "distinct_envs", float(max(counts)), "", "neither",
        method=f"largest number of distinct environments in a run, by {method}", n=group.key.n_env,
        extra={"per_run": counts, "classes": classes, "first_difference_step": _first_difference(hashes)},
    )  # fmt: skip


def _first_difference(hashes: list[NDArray[np.uint64]]) -> int | None:
    steps = []
    for one in hashes:
        differing = np.flatnonzero((one != one[:, :1]).any(axis=1))
        if differing.size:
            steps.append(int(differing[0]))
    return min(steps, default=None)


def _distinct_runs(hashes: list[NDArray[np.uint64]], method: str) -> Metric:
    if len(hashes) < 2:
        return not_computed("distinct_runs", "", "neither", "needs at least two complete runs")
    if len({h.shape for h in hashes}) > 1:
        return not_computed("distinct_runs", "", "neither", "the runs captured different numbers of steps")
    stacked = np.stack(hashes)
    differing = np.flatnonzero((stacked != stacked[:1]).any(axis=(0, 2)))
    return Metric(
        "distinct_runs", float(count_distinct(stacked)), "", "neither",
        method=f"distinct runs, env by env, by {method}", n=len(hashes),
        extra={
            "classes": bitwise_classes(stacked).tolist(),
            "first_difference_step": int(differing[0]) if differing.size else None,
        },
    )  # fmt: skip


def identical_steps(one: Group, other: Group) -> int:
    """Number of captured states over which all runs of two groups agree by bits, 0 where they differ anywhere.

    Groups of different scenes, steps, environment counts or layouts are not compared.
    """
    same = ("scene_hash", "n_env", "dt")
    if any(getattr(one.key, name) != getattr(other.key, name) for name in same) or _layout(one) != _layout(other):
        return 0
    hashes = [f.hashes for g in (one, other) for r in g.complete if (f := r.fingerprints("capture")) is not None]
    if len(hashes) < len(one.complete) + len(other.complete) or not (one.complete and other.complete):
        return 0
    steps = min(len(h) for h in hashes)
    return steps if count_distinct(np.stack([h[:steps] for h in hashes])) == 1 else 0


def _layout(group: Group) -> Any:
    return group.complete[0].fields if group.complete else None


def capture_effect(group: Group) -> Metric:
    """In how many runs the states differ between the timed phase, which nothing observes, and the capture phase."""
    name = "capture_changes_states"
    compared, changed = 0, 0
    for recording in group.complete:
        timed, captured = recording.fingerprints("timed"), recording.fingerprints("capture")
        if timed is None or captured is None:
            continue
        common, at_timed, at_captured = np.intersect1d(timed.steps, captured.steps, return_indices=True)
        if not len(common):
            continue
        compared += 1
        changed += bool((timed.hashes[at_timed] != captured.hashes[at_captured]).any())
    if not compared:
        return not_computed(name, "", "lower", "no step was passed by both the timed and the capture phase")
    return Metric(
        name, float(changed), "", "lower", n=compared,
        method="runs whose state hashes differ between timed and capture phase at a step that both passed",
    )  # fmt: skip


def parallel(sampled: Sample) -> tuple[Metric, NDArray[np.float64] | None]:
    """Parallel variability: mean over runs of the mean W1 over pairs of environments, with the first run's matrix."""
    name = "w1_parallel"
    if sampled.positions is None:
        return not_computed(name, "cm", "lower", sampled.why_not), None
    if sampled.positions.shape[1] < 2:
        return not_computed(name, "cm", "lower", "needs at least two environments"), None
    per_run: dict[bytes, Any] = {}
    found = []
    for positions in sampled.positions:
        key = positions.tobytes()  # identical runs are solved once
        if key not in per_run:
            per_run[key] = parallel_variability(positions)
        found.append(per_run[key])
    values = [f.mean_cm for f in found]
    metric = _mean_over_runs(
        name, "cm", "lower", values,
        method="W1 between the planar positions of two environments, mean over pairs, mean over runs",
        extra={"per_run": values, "distinct_at_sample_step": [f.n_distinct for f in found]},
    )  # fmt: skip
    return metric, found[0].matrix_cm


def run_to_run(sampled: Sample) -> tuple[Metric, NDArray[np.float64] | None]:
    """Run-to-run variability: mean and SD of W1 over pairs of runs, all environments of a run pooled."""
    name = "w1_run_to_run"
    if sampled.positions is None:
        return not_computed(name, "cm", "lower", sampled.why_not), None
    if len(sampled.positions) < 2:
        return not_computed(name, "cm", "lower", "needs at least two complete runs"), None
    found = run_to_run_variability(sampled.positions)
    interval = jackknife_pair_mean(found.matrix_cm)
    floor = _floor(sampled.positions[0], sampled.positions[1])
    runs = len(sampled.positions)
    metric = Metric(
        name, found.mean_cm, "cm", "lower", n=runs * (runs - 1) // 2, sd=found.sd_cm, ci95=_bounds(interval),
        method="W1 between the pooled planar positions of two runs, mean and SD over pairs of runs; "
        f"interval: {interval.method}",
        extra={"n_run": runs, "interval_why_not": interval.reason or "", "floor_first_pair": floor},
    )  # fmt: skip
    return metric, found.matrix_cm


def real(sampled: Sample, reference: Reference | None, no_reference: str, group: Group) -> Metric:
    """Gap to the reference: mean and SD over runs of W1 between all positions of a run and all of the reference."""
    name = "w1_real"
    if reference is None:
        return not_computed(name, "cm", "lower", no_reference)
    if sampled.positions is None:
        return not_computed(name, "cm", "lower", sampled.why_not)
    if reference.scene != group.key.scene:
        return not_computed(name, "cm", "lower", f"the reference is of scene {reference.scene}")
    if sampled.positions.shape[2] != reference.positions.shape[1]:
        why = f"the reference has {reference.positions.shape[1]} items, this group {sampled.positions.shape[2]}"
        return not_computed(name, "cm", "lower", why)
    gaps: dict[bytes, Any] = {}
    for positions in sampled.positions:
        if positions.tobytes() not in gaps:
            gaps[positions.tobytes()] = sim_to_real_gap(positions, reference.positions)
    found = [gaps[p.tobytes()] for p in sampled.positions]
    values = [f.value_cm for f in found]
    extra: dict[str, Any] = {"per_run": values, "reference": reference.label, "measured": reference.measured}
    extra["floor_first_run"] = _floor(sampled.positions[0], reference.positions)
    if found[0].extension:
        extra["extension"] = found[0].extension
    return _mean_over_runs(
        name, "cm", "lower", values, extra=extra,
        method=f"W1 between the planar positions of a run and {reference.label}, mean over runs ({found[0].method})",
    )  # fmt: skip


def left_board(group: Group, sampled: Sample) -> Metric:
    """Mean number of cubes per environment that are not on the board at the sample step."""
    name = "left_board"
    if sampled.positions is None:
        return not_computed(name, "", "lower", sampled.why_not)
    scene = group.complete[0].scene
    board = next((b for b in scene.get("bodies", ()) if b.get("name") == scene.get("board")), None)
    if board is None:
        return not_computed(name, "", "lower", "this scene has no board to leave")
    if sampled.recorded[0].shape[-1] < 3:
        return not_computed(name, "", "lower", "heights were not recorded")
    try:
        size, centre = np.array(board["shape"]["size"], dtype=float), np.array(board["position"], dtype=float)
    except (KeyError, TypeError, ValueError):
        raise DamagedRecording(f"{group.complete[0].path}: the scene's board is unreadable") from None
    counts = []
    for recording, recorded in zip(group.complete, sampled.recorded, strict=True):
        simulation = recording.simulation
        origins = np.array(simulation.env_origins) if simulation and simulation.env_origins else np.zeros((1, 3))
        counts.append(int(count_left_board(recorded - origins[:, None], size=size, centre=centre).sum()))
    envs = sampled.positions.shape[1]
    return Metric(
        name, sum(counts) / (len(counts) * envs), "cubes per env", "lower", n=len(counts) * envs,
        method="cubes whose centre is beside or below the board at the sample step",
        extra={"total": sum(counts), "of": sampled.positions[..., 0].size, "per_run": counts},
    )  # fmt: skip


def regime(parallel: Metric, between: Metric) -> Metric:
    """The published type, 1 to 4."""
    name = "regime_published"
    for needed in (parallel, between):
        if needed.value is None:
            return not_computed(name, "", "neither", f"{needed.name} could not be computed: {needed.why_not}")
    assert parallel.value is not None and between.value is not None
    return Metric(
        name, float(published_regime(parallel.value, between.value)), "type", "neither",
        method="variability counts as present where it is nonzero after rounding to 0.01 cm",
    )  # fmt: skip


def _mean_over_runs(
    name: str, unit: str, direction: str, values: list[float], *, method: str, extra: dict[str, Any],
) -> Metric:  # fmt: skip
    runs = len(values)
    interval = jackknife_mean(np.array(values), nonnegative=True) if runs > 1 else None
    return Metric(
        name, float(np.mean(values)), unit, direction, n=runs,
        sd=float(np.std(values, ddof=1)) if runs > 1 else None,
        ci95=_bounds(interval) if interval else None,
        method=method + (f"; interval: {interval.method}" if interval else ""), extra=extra,
    )  # fmt: skip


def _bounds(interval: Interval) -> tuple[float, float] | None:
    return (interval.low, interval.high) if interval.low is not None and interval.high is not None else None


def _floor(a: NDArray[np.float64], b: NDArray[np.float64]) -> dict[str, float]:
    """What W1 [cm] would be between two samples of one law: whole environments exchanged at random."""
    floor = permutation_floor(a * 100.0, b * 100.0, n_permutation=_PERMUTATIONS, seed=_SEED)
    return {
        "observed_cm": floor.observed,
        "floor_mean_cm": floor.floor_mean,
        "floor_q95_cm": floor.floor_q95,
        "p_value": floor.p_value,
        "permutations": floor.n_permutation,
        "seed": floor.seed,
    }
