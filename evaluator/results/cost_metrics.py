"""What the runs of a group cost: time of steps, of building and compiling, and memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.metrics.radar import Axis as RadarAxis
from gpusimbench.evaluator.metrics.throughput import frames_per_second, overhead
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.read.known_errors import wrong_time
from gpusimbench.evaluator.results.details import (
    CaptureOverhead,
    DistinctRuns,
    Memory,
    RunPresence,
    SharedRun,
    ShrunkRun,
    Throughput,
)
from gpusimbench.evaluator.results.group_runs import MEDIAN, GroupRuns, Runs
from gpusimbench.evaluator.results.identity_metrics import DISTINCT_RUNS, hashed_by
from gpusimbench.evaluator.results.metric import Axis, Direction, Estimate, Metric, each, missing, over_runs
from gpusimbench.evaluator.results.timed_work import Speeds, speeds_of
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.statistics.jackknife import MIN_RUNS_A_SIDE, ratio_of_means
from gpusimbench.schemas.text import plural

_SLOWER = 0.95
"""Throughput in proportion to another, at most, that few runs show to be lower."""

_NOT_SAMPLED = "the timed phase was left out, or no memory was sampled in it"


def _fps(run: Run) -> float | Missing:
    c = run.configuration
    if not (run.elapsed_s and run.timed_steps):
        return Missing("the timed phase was left out")
    if wrong := wrong_time(run):
        return Missing(wrong)
    return frames_per_second(c.n_env, run.timed_steps, run.elapsed_s)


def _throughput(group: GroupRuns) -> Throughput:
    simulation = group.runs[0].simulation
    return Throughput(
        timing_covers=simulation.timing_covers if simulation else "", co_tenants=_presence(group.runs),
        speeds=_speeds(group),
    )  # fmt: skip


def ranked_throughput(fps: Estimate) -> float:
    """Throughput by which a group is ranked [env-steps/s]; 0 where none was timed.

    The mean over runs; where throughput goes with the outcome, which no run can choose, that of the slowest run.
    """
    speeds = fps.of(Throughput).speeds
    return speeds.outcomes[0].low if speeds else known(fps.value) or 0.0


def ranked_words(fps: Estimate) -> str:
    """The throughput of `ranked_throughput` in words, with its unit."""
    speeds = fps.of(Throughput).speeds
    return speeds.slowest if speeds else f"{ranked_throughput(fps):,.0f} {FPS.unit}"


def shown_slower(slower: Estimate, faster: Estimate) -> bool:
    """Whether a throughput is shown to be lower than another.

    It is where the 95 % interval of the ratio of means over runs ends below 1; of fewer than three runs a side, which
    have no interval, where it is lower by 5 % at least.
    """
    of_slower, of_faster = (fps.of(Throughput).per_run or () for fps in (slower, faster))
    found = ratio_of_means(of_slower, of_faster)
    if found.ci95:
        return found.ci95[1] < 1
    # of many runs, none differs from another of its side
    many = min(len(of_slower), len(of_faster)) >= MIN_RUNS_A_SIDE
    return found.estimate < 1 if many else found.estimate <= _SLOWER


def _speeds(group: GroupRuns) -> Speeds | None:
    """Throughputs by outcome, where runs have several outcomes and throughput goes with them."""
    classes = DISTINCT_RUNS.estimate(group).of(DistinctRuns).classes
    hashed = [_fps(run) for run, _ in hashed_by(group.runs)[0]] if classes else []
    timed = [(fps, label) for fps, label in zip(hashed, classes, strict=True) if not isinstance(fps, Missing)]
    return speeds_of([fps for fps, _ in timed], [label for _, label in timed])


def _presence(runs: Runs) -> tuple[RunPresence, ...] | None:
    if not any(r.gpu for r in runs):
        return None
    return tuple(RunPresence(_index(r), r.cotenants.presence, tuple(r.cotenants.signs)) for r in runs)


def _index(run: Run) -> int:
    return run.configuration.run_index


def _no_gpu(run: Run) -> Missing | None:
    of = run
    if not of.provenance.gpus:
        return Missing("no GPU on the machine that recorded")
    return Missing("this simulator ran on the CPU") if of.simulation and of.simulation.device == "cpu" else None


def _device_increment(run: Run) -> float | Missing:
    if (none := _no_gpu(run)) is not None:
        return none
    if run.cotenants.presence is Presence.SOME:
        return Missing("another process was on the GPU")
    found = run.gpu.device.peak_increment if run.gpu else None
    return Missing(_NOT_SAMPLED) if found is None else found


def _process_peak(run: Run) -> float | Missing:
    if (none := _no_gpu(run)) is not None:
        return none
    found = process_peak(run)
    return (
        Missing("the timed phase was left out, or NVML attributed no memory to the run's process")
        if found is None
        else found
    )


def process_peak(run: Run) -> int | None:
    """What NVML attributed to the run's process in the timed phase, at most [byte]; None where it did not tell."""
    return run.gpu.process.peak if run.gpu and run.gpu.process else None


def _allocator_peak(run: Run) -> float | Missing:
    if (none := _no_gpu(run)) is not None:
        return none
    why_not = "the engine's allocator did not tell its peak, or had it while the simulator was built"
    return Missing(why_not) if isinstance(run.allocator, Missing) else run.allocator


def _host_increment(run: Run) -> float | Missing:
    found = run.host.peak_increment if run.host else None
    return Missing(_NOT_SAMPLED) if found is None else found


def _device_memory(group: GroupRuns) -> Memory:
    shared = tuple(
        SharedRun(
            _index(r),
            r.gpu.device.peak - r.gpu.device.baseline
            if r.gpu and r.gpu.device.peak is not None and r.gpu.device.baseline is not None
            else None,
            process_peak(r),
        )
        for r in group.runs
        if r.cotenants.presence is Presence.SOME
    )
    return Memory(
        source="device", checkpoints_bytes=tuple(r.gpu.device for r in group.runs if r.gpu), runs_left_out=shared
    )  # fmt: skip


def _process_memory(group: GroupRuns) -> Memory:
    processes = tuple(r.gpu.process for r in group.runs if r.gpu and r.gpu.process)
    return Memory(source="process", checkpoints_bytes=processes)


def _host_memory(group: GroupRuns) -> Memory:
    return Memory(
        source="host",
        checkpoints_bytes=tuple(r.host for r in group.runs if r.host),
        runs_left_out=tuple(ShrunkRun(_index(r)) for r in group.runs if r.host and r.host.shrank),
    )


def _device(metric: Metric, group: GroupRuns) -> Estimate:
    """Of runs that no other process shared the device with, as far as is known."""
    shared = sum(r.cotenants.presence is Presence.SOME for r in group.runs)
    found = over_runs(metric, group, f"{metric.method}, of runs without a known co-tenant" if shared else "")
    if not isinstance(found.value, Missing) or not group.runs or _no_gpu(group.runs[0]) is not None:
        return found
    why = f"another process was on the GPU in {shared} of {plural(len(group.runs), 'run')}" if shared else _NOT_SAMPLED
    return missing(metric, why, _device_memory(group))


def _host(metric: Metric, group: GroupRuns) -> Estimate:
    found = over_runs(metric, group)
    if not isinstance(found.value, Missing) or not group.runs:
        return found
    details = _host_memory(group)
    why = "the process held less in the timed phase than at the baseline" if details.runs_left_out else _NOT_SAMPLED
    return missing(metric, why, details)


def _compile_times(group: GroupRuns) -> list[float | Missing]:
    none = Missing("compilation was not clocked")
    return [run.compile_s.get(_compiled(group), none) for run in group.runs]


def _compiled(group: GroupRuns) -> str:
    """The phase whose compilation is told: what the capture runs, where nothing was timed."""
    return next((p for p in ("timed", "capture") if any(p in r.compile_s for r in group.runs)), "")


def _compile(metric: Metric, group: GroupRuns) -> Estimate:
    return over_runs(metric, group, f"compilation of what the {_compiled(group)} phase runs")


def _overhead(run: Run) -> float | Missing:
    c = run.configuration
    if not (run.capture_s and run.elapsed_s and run.timed_steps):
        return Missing("timed and captured steps were not both clocked")
    if wrong := wrong_time(run):
        return Missing(wrong)
    return overhead(run.capture_s, c.captured_steps, run.elapsed_s, run.timed_steps)


def _capture(group: GroupRuns) -> CaptureOverhead:
    stalled = [(r.stalled_s or 0.0) / r.capture_s for r in group.runs if r.capture_s and r.elapsed_s]
    return CaptureOverhead(stalled_share=float(np.mean(stalled)))


FPS = Metric(
    "fps", "throughput", "env-steps/s", Direction.HIGHER,
    "environment-steps per second of the timed phase, N_env * N_step / T_step; mean over runs ([by "
    "outcome](#throughput-by-outcome))",
    method="N_env * N_step / T_step of the timed phase", published=True,
    values=each(_fps), details=_throughput, axis=Axis.THROUGHPUT, radar=RadarAxis.THROUGHPUT,
)  # fmt: skip

DEVICE_MEMORY = Metric(
    "memory_peak_increment", "GPU memory increment", "GB", Direction.LOWER,
    "largest reading of NVML's figure for the whole device in the [first timed window](#time-windows-and-memory) minus "
    "the baseline; the device is the first that CUDA shows to the run. Mean over runs without a known "
    "[co-tenant](#gpu-memory-and-other-processes)",
    method="peak of the timed phase minus baseline (NVML, the whole of the device that steps)", published=True,
    values=each(_device_increment), details=_device_memory, of_group=_device,
    interval="delete-one-run jackknife", axis=Axis.MEMORY, radar=RadarAxis.MEMORY,
)  # fmt: skip

PROCESS_MEMORY = Metric(
    "process_memory_peak", "GPU memory of the process", "GB", Direction.LOWER,
    "largest reading, in the first timed window, of the memory that NVML attributes to the run's process; mean over "
    "all runs",
    method="largest reading of the timed phase (NVML, of the run's process, which held none before)",
    values=each(_process_peak), details=_process_memory, optional=True, axis=Axis.MEMORY,
)  # fmt: skip

ALLOCATOR_PEAK = Metric(
    "allocator_peak", "peak of the engine's allocator", "GB", Direction.LOWER,
    "peak that the engine's own device allocator reports at the end of the timed phase, without the memory of CUDA "
    "graphs; no value if the peak was reached while the simulator was built; mean over runs",
    method="peak that the engine's own allocator kept",
    values=each(_allocator_peak), details=lambda _: Memory(source="allocator"), optional=True, axis=Axis.MEMORY,
)  # fmt: skip

HOST_MEMORY = Metric(
    "host_memory_peak_increment", "host memory increment", "MB", Direction.LOWER,
    "largest resident set of the run's process in the first timed window minus the baseline; mean over runs",
    method="peak of the timed phase minus baseline (resident set of the run's process)",
    values=each(_host_increment), details=_host_memory, of_group=_host,
    interval="delete-one-run jackknife", axis=Axis.MEMORY,
)  # fmt: skip

BUILD_TIME = Metric(
    "build_time", "time to build", "s", Direction.LOWER,
    "time for importing the engine, sizing its buffers, loading the model and allocating; median over runs, because "
    "the first run of a set fills the caches of the others",
    method="import of the engine, sizing of its buffers, loading of the model, allocation",
    values=each(lambda run: run.build_s),
    aggregate=MEDIAN, optional=True, axis=Axis.BUILD,
)  # fmt: skip

COMPILE_TIME = Metric(
    "compile_time", "time to compile", "s", Direction.LOWER,
    "time for compiling the program of the timed phase (of the capture phase, if nothing was timed); median over runs",
    method="compilation of what the timed (or else the capture) phase runs",
    values=_compile_times, aggregate=MEDIAN, of_group=_compile, optional=True, axis=Axis.BUILD,
)  # fmt: skip

CAPTURE_OVERHEAD = Metric(
    "capture_slowdown", "capture overhead", "", Direction.LOWER,
    "duration of a captured step relative to a timed step, (T_capture / N_capture) / (T_timed / N_timed); mean over "
    "runs. The two phases make different steps of the scene, so contacts that occur late change the ratio",
    method="time of a captured step / of a timed step",
    values=each(_overhead), remark="; the phases make other steps of the scene", details=_capture, optional=True,
)  # fmt: skip

COSTS = (
    FPS, DEVICE_MEMORY, PROCESS_MEMORY, ALLOCATOR_PEAK, HOST_MEMORY, BUILD_TIME, COMPILE_TIME, CAPTURE_OVERHEAD,
)  # fmt: skip
"""Metrics of what runs cost."""

GPU_MEMORY = (DEVICE_MEMORY.name, PROCESS_MEMORY.name)
"""Metrics of GPU memory that groups can be compared by, in the order in which they are asked: the published first."""


def common_memory(found: Sequence[Mapping[str, Estimate]]) -> str:
    """The metric of memory by which groups can be compared: figures of different sources are different quantities.

    The first of the device's increment, the process's own and the host's increment that each group has; the one that
    most have, where none is everyone's.
    """
    having = {name: sum(not isinstance(m[name].value, Missing) for m in found) for name in GPU_MEMORY}
    if not any(having.values()):
        return HOST_MEMORY.name
    return max(GPU_MEMORY, key=lambda name: having[name])
