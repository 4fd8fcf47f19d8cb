"""What the runs of a group cost: time of steps, of building and compiling, and memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evaluator.metrics.memory import Checkpoints
from evaluator.metrics.throughput import frames_per_second
from evaluator.over_runs import NO_RUN, Runs, mean_over_runs
from evaluator.results import Metric, not_computed

_GB = 1e9
_MB = 1e6


def throughput(runs: Runs) -> Metric:
    """FPS: mean over runs of N_env * N_step / T_step of the timed phase."""
    name, unit = "fps", "env-steps/s"
    values = [
        frames_per_second(r.recording.configuration.n_env, r.recording.configuration.timed_steps, r.elapsed_s)
        for r in runs
        if r.elapsed_s is not None
    ]
    if not values:
        return not_computed(name, unit, "higher", "the timed phase was left out" if runs else NO_RUN)
    simulation = runs[0].recording.simulation
    covers = simulation.timing_covers if simulation else ""
    method = "N_env * N_step / T_step of the timed phase, mean over runs"
    return mean_over_runs(name, unit, "higher", values, method=method, extra={"timing_covers": covers})


def memory_peak_increment(runs: Runs) -> Metric:
    """GPU memory: largest reading of the timed phase minus the baseline, as the hardware monitor reports it."""
    name, unit = "memory_peak_increment", "GB"
    if why_not := _no_gpu(runs):
        return not_computed(name, unit, "lower", why_not)
    # recordings list the GPUs that CUDA shows, in its order, and engines step on the first of them
    return _memory([r.gpu for r in runs], name, unit, _GB, "NVML, the whole of the device that steps")


def allocator_peak(runs: Runs) -> Metric:
    """GPU memory by the engine's own allocator: its peak up to the end of the timed phase."""
    name, unit = "allocator_peak", "GB"
    if why_not := _no_gpu(runs):
        return not_computed(name, unit, "lower", why_not)
    values = [r.allocator / _GB for r in runs if r.allocator is not None]
    if not values:
        return not_computed(
            name, unit, "lower", "the engine's allocator did not tell its peak, or had it while the simulator was built"
        )
    method = f"peak that the engine's own allocator kept, mean over runs; 1 {unit} = {_GB:.0e} B"
    return mean_over_runs(name, unit, "lower", values, method=method, extra={})


def _no_gpu(runs: Runs) -> str:
    if not runs:
        return NO_RUN
    first = runs[0].recording
    if not first.provenance.gpus:
        return "no GPU on the machine that recorded"
    return "this simulator ran on the CPU" if first.simulation and first.simulation.device == "cpu" else ""


def build_time(runs: Runs) -> Metric:
    """Time that building the simulator takes: median over runs."""
    why_not = "building was not clocked" if runs else NO_RUN
    values = [r.build_s for r in runs if r.build_s is not None]
    return _median_time(
        "build_time", values, "import of the engine, sizing of its buffers, loading of the model, allocation", why_not
    )


def compile_time(runs: Runs) -> Metric:
    """Time that compiling what the timed phase runs takes (what the capture runs, where nothing was timed): median."""
    phase = next((p for p in ("timed", "capture") if any(p in r.compile_s for r in runs)), "")
    why_not = "compilation was not clocked" if runs else NO_RUN
    values = [r.compile_s[phase] for r in runs if phase in r.compile_s]
    return _median_time("compile_time", values, f"compilation of what the {phase} phase runs", why_not)


def capture_slowdown(runs: Runs) -> Metric:
    """Time of a step of the capture phase over that of the timed phase, and how much of it was waiting for the disk."""
    name = "capture_slowdown"
    ratios, stalled = [], []
    for run in runs:
        c = run.recording.configuration
        if run.capture_s and run.elapsed_s:
            ratios.append(run.capture_s / c.steps / (run.elapsed_s / c.timed_steps))
            stalled.append(run.stalled_s / run.capture_s)
    if not ratios:
        why_not = "timed and captured steps were not both clocked" if runs else NO_RUN
        return not_computed(name, "", "lower", why_not)
    method = "time of a captured step / of a timed step, mean over runs; the phases make other steps of the scene"
    return mean_over_runs(name, "", "lower", ratios, method=method, extra={"stalled_share": float(np.mean(stalled))})


def _median_time(name: str, values: list[float], what: str, why_not: str) -> Metric:
    if not values:
        return not_computed(name, "s", "lower", why_not)
    # the first run of a set fills the caches on disk that the others find: a mean would mix the two
    median = float(np.median(values))
    return Metric(
        name, median, "s", "lower", n=len(values), method=f"{what}, median over runs", extra={"per_run": values}
    )


def host_memory_peak_increment(runs: Runs) -> Metric:
    """Host memory: largest resident set of the timed phase minus the baseline."""
    name, unit = "host_memory_peak_increment", "MB"
    if not runs:
        return not_computed(name, unit, "lower", NO_RUN)
    return _memory([r.host for r in runs], name, unit, _MB, "resident set of the run's process")


def _memory(found: Sequence[Checkpoints | None], name: str, unit: str, scale: float, monitor: str) -> Metric:
    checkpoints = [c for c in found if c is not None]
    values = [c.peak_increment / scale for c in checkpoints if c.peak_increment is not None]
    if not values:
        return not_computed(name, unit, "lower", "the timed phase was left out, or no memory was sampled in it")
    method = f"peak of the timed phase minus baseline ({monitor}), mean over runs; 1 {unit} = {scale:.0e} B"
    extra = {"checkpoints_bytes": [vars(c) for c in checkpoints]}
    return mean_over_runs(name, unit, "lower", values, method=method, extra=extra)
