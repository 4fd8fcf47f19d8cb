"""What the runs of a group cost: time of steps, of building and compiling, and memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.metrics.throughput import frames_per_second
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.aggregate import NO_RUN, Runs, mean_over_runs
from gpusimbench.evaluator.results.result import Metric, not_computed
from gpusimbench.evaluator.runs.run import Run

_GB = 1e9
_MB = 1e6

_NOT_SAMPLED = "the timed phase was left out, or no memory was sampled in it"

GPU_MEMORY = ("memory_peak_increment", "process_memory_peak")
"""Metrics of GPU memory that groups can be compared by, in the order in which they are asked: the published first."""

HOST_MEMORY = "host_memory_peak_increment"


def throughput(runs: Runs) -> Metric:
    """FPS: mean over runs of N_env * N_step / T_step of the timed phase."""
    name, unit = "fps", "env-steps/s"
    values = [
        frames_per_second(r.configuration.n_env, r.configuration.timed_steps, r.elapsed_s)
        for r in runs
        if not isinstance(r.elapsed_s, Missing)
    ]
    if not values:
        return not_computed(name, unit, "higher", "the timed phase was left out" if runs else NO_RUN)
    simulation = runs[0].simulation
    covers = simulation.timing_covers if simulation else ""
    method = "N_env * N_step / T_step of the timed phase, mean over runs"
    extra = {"timing_covers": covers, "co_tenants": _presence(runs)}
    return mean_over_runs(name, unit, "higher", values, method=method, extra=extra)


def _presence(runs: Runs) -> list[dict[str, Any]] | None:
    """By run, whether another process was on the device that stepped; None where the simulator ran on the CPU."""
    if not any(r.gpu for r in runs):
        return None
    return [
        {
            "run": r.configuration.run_index,
            "presence": r.cotenants.presence.value,
            "signs": [vars(sign) for sign in r.cotenants.signs],
        }
        for r in runs
    ]


def device_increment(run: Run) -> int | None:
    """What the whole device held in the timed phase beyond the baseline [byte].

    None where it was not sampled, and where another process was on the device, whose memory it would count.
    """
    shared = run.cotenants.presence is Presence.SOME
    return None if shared or not run.gpu else run.gpu.device.peak_increment


def process_peak(run: Run) -> int | None:
    """What NVML attributed to the run's process in the timed phase, at most [byte]; None where it did not tell."""
    return run.gpu.process.peak if run.gpu and run.gpu.process else None


def memory_peak_increment(runs: Runs) -> Metric:
    """GPU memory: largest reading of the timed phase minus the baseline, as the hardware monitor reports it.

    Of runs that no other process shared the device with, as far as is known.
    """
    name, unit = "memory_peak_increment", "GB"
    if why_not := _no_gpu(runs):
        return not_computed(name, unit, "lower", why_not)
    left_out = [
        {
            "run": r.configuration.run_index,
            "increment_bytes": r.gpu.device.peak - r.gpu.device.baseline
            if r.gpu and r.gpu.device.peak is not None and r.gpu.device.baseline is not None
            else None,
            "process_bytes": process_peak(r),
        }
        for r in runs
        if r.cotenants.presence is Presence.SOME
    ]
    extra = {
        "source": "device",
        "checkpoints_bytes": [vars(r.gpu.device) for r in runs if r.gpu],
        "left_out": left_out,
    }
    values = [value / _GB for r in runs if (value := device_increment(r)) is not None]
    if not values:
        why = f"another process was on the GPU in {len(left_out)} of {len(runs)} runs" if left_out else _NOT_SAMPLED
        return replace(not_computed(name, unit, "lower", why), extra=extra)
    alone = ", of runs without a known co-tenant" if left_out else ""
    method = (
        f"peak of the timed phase minus baseline (NVML, the whole of the device that steps){alone}, mean over runs; "
        f"1 {unit} = {_GB:.0e} B"
    )
    return mean_over_runs(name, unit, "lower", values, method=method, extra=extra)


def process_memory_peak(runs: Runs) -> Metric:
    """GPU memory that the hardware monitor attributes to the run's own process: of all runs, whoever else was there."""
    name, unit = "process_memory_peak", "GB"
    if why_not := _no_gpu(runs):
        return not_computed(name, unit, "lower", why_not)
    values = [value / _GB for r in runs if (value := process_peak(r)) is not None]
    if not values:
        why = "the timed phase was left out, or NVML attributed no memory to the run's process"
        return not_computed(name, unit, "lower", why)
    method = (
        f"largest reading of the timed phase (NVML, of the run's process, which held none before), mean over runs; "
        f"1 {unit} = {_GB:.0e} B"
    )
    extra = {"source": "process", "checkpoints_bytes": [vars(r.gpu.process) for r in runs if r.gpu and r.gpu.process]}
    return mean_over_runs(name, unit, "lower", values, method=method, extra=extra)


def common_memory(found: Sequence[Mapping[str, Metric]]) -> str:
    """The metric of memory by which groups can be compared: figures of different sources are different quantities.

    The first of the device's increment, the process's own and the host's increment that each group has; the one that
    most have, where none is everyone's.
    """
    having = {name: sum(m[name].value is not None for m in found) for name in (*GPU_MEMORY, HOST_MEMORY)}
    if not any(having[name] for name in GPU_MEMORY):
        return HOST_MEMORY
    return max(GPU_MEMORY, key=lambda name: having[name])


def allocator_peak(runs: Runs) -> Metric:
    """GPU memory by the engine's own allocator: its peak up to the end of the timed phase."""
    name, unit = "allocator_peak", "GB"
    if why_not := _no_gpu(runs):
        return not_computed(name, unit, "lower", why_not)
    values = [r.allocator / _GB for r in runs if not isinstance(r.allocator, Missing)]
    if not values:
        return not_computed(
            name, unit, "lower", "the engine's allocator did not tell its peak, or had it while the simulator was built"
        )
    method = f"peak that the engine's own allocator kept, mean over runs; 1 {unit} = {_GB:.0e} B"
    return mean_over_runs(name, unit, "lower", values, method=method, extra={"source": "allocator"})


def _no_gpu(runs: Runs) -> str:
    if not runs:
        return NO_RUN
    first = runs[0]
    if not first.provenance.gpus:
        return "no GPU on the machine that recorded"
    return "this simulator ran on the CPU" if first.simulation and first.simulation.device == "cpu" else ""


def build_time(runs: Runs) -> Metric:
    """Time that building the simulator takes: median over runs."""
    why_not = "building was not clocked" if runs else NO_RUN
    values = [r.build_s for r in runs if not isinstance(r.build_s, Missing)]
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
        c = run.configuration
        if run.capture_s and run.elapsed_s and not isinstance(run.stalled_s, Missing):
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
    name, unit = HOST_MEMORY, "MB"
    if not runs:
        return not_computed(name, unit, "lower", NO_RUN)
    checkpoints = [r.host for r in runs if r.host]
    values = [c.peak_increment / _MB for c in checkpoints if c.peak_increment is not None]
    shrank = [r.configuration.run_index for r in runs if r.host and r.host.shrank]
    extra = {
        "source": "host",
        "checkpoints_bytes": [vars(c) for c in checkpoints],
        "left_out": [{"run": run} for run in shrank],
    }
    if not values:
        why = "the process held less in the timed phase than at the baseline" if shrank else _NOT_SAMPLED
        return replace(not_computed(name, unit, "lower", why), extra=extra)
    method = (
        f"peak of the timed phase minus baseline (resident set of the run's process), mean over runs; "
        f"1 {unit} = {_MB:.0e} B"
    )
    return mean_over_runs(name, unit, "lower", values, method=method, extra=extra)
