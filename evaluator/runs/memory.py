"""What a run held in memory, at the checkpoints of its phases."""

from __future__ import annotations

from gpusimbench.evaluator.metrics.cotenants import BASELINE, CHECKPOINTS, TIMED
from gpusimbench.evaluator.metrics.memory import Checkpoints, GpuMemory, Listing
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.streams import MemoryTrace


def gpu_memory(recording: Recording) -> GpuMemory | Missing:
    """Memory of the device that a recording's simulator stepped on."""
    if not recording.provenance.gpus:
        return Missing("no GPU on the machine that recorded")
    if recording.simulation and recording.simulation.device == "cpu":
        return Missing("this simulator ran on the CPU")
    # recordings list the GPUs that CUDA shows, in its order, and engines step on the first of them
    device = recording.memory.get("gpu0/device")
    if device is None:
        return Missing("no memory of the GPU was sampled")
    own = recording.memory.get("gpu0/process")
    found = {name: device.most_others(checkpoint=name) for name in CHECKPOINTS}
    found[TIMED] = device.most_others(phase=TIMED)
    return GpuMemory(
        _checkpoints(recording, device),
        _checkpoints(recording, own) if own else None,
        {moment: Listing(*others) for moment, others in found.items() if others},
        device.reserved.get(BASELINE),
    )


def host_memory(recording: Recording) -> Checkpoints | Missing:
    """Memory of the process."""
    trace = recording.memory.get("host")
    return _checkpoints(recording, trace) if trace else Missing("no memory of the process was sampled")


def allocator_peak(recording: Recording) -> int | Missing:
    """Peak of the engine's own device allocator up to the end of the timed phase [byte]."""
    trace = recording.memory.get("gpu0/allocator") if "timed" in recording.configuration.phases else None
    peak = trace.own_peak() if trace else None
    return Missing("the engine's allocator did not tell its peak") if peak is None else peak


def _checkpoints(recording: Recording, trace: MemoryTrace) -> Checkpoints:
    timed = recording.timing.get("timed")
    peak = None if timed is None else trace.peak("timed", timed.first_end_ns)
    return Checkpoints(trace.at("baseline"), trace.at("post-init"), trace.at("post-warmup"), peak, trace.at("final"))
