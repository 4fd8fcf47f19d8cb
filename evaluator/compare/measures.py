"""What is compared as a number of each run: metrics of the registry, and what only a comparison asks of runs."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.metrics.cotenants import Presence
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.aggregate import Runs
from gpusimbench.evaluator.results.cost_metrics import GPU_MEMORY, process_peak
from gpusimbench.evaluator.results.metric import Axis, Direction, Metric, each
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.runs.run import Run


def contacts_of(run: Run) -> float | Missing:
    """Contacts of an environment at a step: of the timed phase, or else of the captured steps."""
    counts = run.counts
    found = next(
        (counts[phase]["contacts"] for phase in ("timed", "capture") if "contacts" in counts.get(phase, {})), None
    )
    return found.mean if found else Missing("contacts were not counted")


CONTACTS = Metric(
    "contacts", "contacts of an env", "", Direction.NEITHER,
    "contacts of an environment at a counted step; mean over runs",
    method="mean over environments and counted steps", values=each(contacts_of), axis=Axis.VALIDITY,
)  # fmt: skip


def compared_by(axis: Axis, base: Runs, head: Runs) -> Iterator[Metric]:
    """The metrics of an axis that have a number of each run; GPU memory by the one that both sides have."""
    other_sources = {*GPU_MEMORY} - {_gpu_memory_by(base, head)}
    for metric in (*METRICS.values(), CONTACTS):
        if metric.axis is axis and metric.values is not None and metric.name not in other_sources:
            yield metric


def _gpu_memory_by(base: Runs, head: Runs) -> str:
    """The metric by which GPU memory is compared: of one source on both sides.

    The increment of the whole device, as published; where another process was on the device in a run, what NVML
    attributed to the runs' own processes, if all runs have it.
    """
    device, process = GPU_MEMORY
    runs = (*base, *head)
    shared = any(run.cotenants.presence is Presence.SOME for run in runs)
    return process if shared and all(process_peak(run) is not None for run in runs) else device
