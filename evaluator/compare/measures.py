"""What is compared as a number of each run, and which way is better."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gpusimbench.evaluator.compare.finding import Axis, Direction
from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.metrics.throughput import frames_per_second
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results import cost_metrics as costs
from gpusimbench.evaluator.results.aggregate import NO_RUN, Runs
from gpusimbench.evaluator.results.result import Metric, not_computed
from gpusimbench.evaluator.runs.run import Run


@dataclass(frozen=True)
class Measure:
    """One number of each run.

    unit     "B" for bytes
    of       its value of one run; None where the run does not tell
    metric   the same as gsb-eval has it, which knows why there is no value
    method   in words
    spoilt   whether a run had such a value, which cannot be used
    """

    axis: Axis
    name: str
    title: str
    unit: str
    direction: Direction
    of: Callable[[Run], float | None]
    metric: Callable[[Runs], Metric]
    method: str
    spoilt: Callable[[Run], bool] = lambda _: False

    def why_not(self, runs: Runs) -> str:
        """Why these runs have no value; empty where they have one."""
        found = self.metric(runs)
        return found.why_not if found.value is None else ""


def _fps(run: Run) -> float | None:
    c = run.configuration
    return frames_per_second(c.n_env, c.timed_steps, run.elapsed_s) if run.elapsed_s else None


def _compiled(run: Run) -> float | None:
    return next((run.compile_s[phase] for phase in ("timed", "capture") if phase in run.compile_s), None)


def _or_none(value: float | Missing) -> float | None:
    return None if isinstance(value, Missing) else value


def _shared(run: Run) -> bool:
    """Whether the device that steps was sampled, and another process makes the samples no memory of the run."""
    simulation = run.simulation
    sampled = run.gpu and run.gpu.device.peak_increment is not None
    on_gpu = simulation is not None and simulation.device != "cpu"
    return bool(sampled) and on_gpu and costs.device_increment(run) is None


def contacts_of(run: Run) -> float | None:
    """Contacts of an environment at a step: of the timed phase, or else of the captured steps."""
    counts = run.counts
    found = next(
        (counts[phase]["contacts"] for phase in ("timed", "capture") if "contacts" in counts.get(phase, {})), None
    )
    return found.mean if found else None


def _contacts(runs: Runs) -> Metric:
    name = "contacts"
    values = [value for run in runs if (value := contacts_of(run)) is not None]
    if not values:
        return not_computed(name, "", "neither", "contacts were not counted" if runs else NO_RUN)
    return Metric(name, sum(values) / len(values), "", "neither", method="mean over runs", n=len(values))


MEASURES = (
    Measure(
        Axis.THROUGHPUT, "fps", "throughput", "env-steps/s", Direction.HIGHER, _fps, costs.throughput,
        "N_env * N_step / T_step of the timed phase",
    ),
    Measure(
        Axis.MEMORY, "memory_peak_increment", "GPU memory increment", "B", Direction.LOWER,
        costs.device_increment, costs.memory_peak_increment,
        "largest reading of the timed phase minus the baseline, the whole device", _shared,
    ),
    Measure(
        Axis.MEMORY, "process_memory_peak", "GPU memory of the process", "B", Direction.LOWER,
        costs.process_peak, costs.process_memory_peak,
        "largest reading of the timed phase, of the run's process alone",
    ),
    Measure(
        Axis.MEMORY, "allocator_peak", "peak of the engine's allocator", "B", Direction.LOWER,
        lambda run: _or_none(run.allocator), costs.allocator_peak, "as the engine's own allocator kept it",
    ),
    Measure(
        Axis.MEMORY, "host_memory_peak_increment", "host memory increment", "B", Direction.LOWER,
        lambda run: run.host.peak_increment if run.host else None, costs.host_memory_peak_increment,
        "largest resident set of the timed phase minus the baseline",
    ),
    Measure(
        Axis.BUILD, "build_time", "time to build", "s", Direction.LOWER,
        lambda run: _or_none(run.build_s), costs.build_time, "import of the engine, loading, allocation",
    ),
    Measure(
        Axis.BUILD, "compile_time", "time to compile", "s", Direction.LOWER, _compiled, costs.compile_time,
        "compilation of what the timed (or else the capture) phase runs",
    ),
    Measure(
        Axis.VALIDITY, "contacts", "contacts of an env", "", Direction.NEITHER, contacts_of, _contacts,
        "mean over environments and counted steps",
    ),
)  # fmt: skip


def gpu_memory_by(base: Runs, head: Runs) -> str:
    """The metric by which GPU memory is compared: of one source on both sides.

    The increment of the whole device, as published; where another process was on the device in a run, what NVML
    attributed to the runs' own processes, if all runs have it.
    """
    device, process = costs.GPU_MEMORY
    runs = (*base, *head)
    shared = any(run.cotenants.presence is Presence.SOME for run in runs)
    return process if shared and all(costs.process_peak(run) is not None for run in runs) else device
