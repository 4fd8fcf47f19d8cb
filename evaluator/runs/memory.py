"""What a run held in memory, and other processes on its device, as far as all runs together tell."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

from gpusimbench.evaluator.metrics.cotenants import BASELINE, CHECKPOINTS, TIMED, Presence, Sign, cotenants, peers_of
from gpusimbench.evaluator.metrics.memory import Checkpoints, GpuMemory, Listing
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.streams import MemoryTrace
from gpusimbench.evaluator.runs.groups import key_of
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.gathering import gathered

_KIND = ("name", "driver", "cuda_driver", "memory_bytes", "compute_capability", "ecc", "mig", "persistence_mode")
"""What the driver keeps for itself depends on, of a GPU."""

_MACHINE = ("cpu", "memory_bytes")
"""The same of the host, by which machines of another kind are told apart."""


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


def with_peers(runs: Sequence[Run]) -> list[Run]:
    """The same runs, each with what all of them tell of the other processes on its device."""
    idle: dict[str, int] = {}
    alike: dict[object, list[GpuMemory]] = {}
    for run in runs:
        if not run.gpu:
            continue
        alike.setdefault(key_of(run), []).append(run.gpu)
        if run.gpu.device.baseline is not None:
            kind = _kind(run)
            idle[kind] = min(run.gpu.device.baseline, idle.get(kind, run.gpu.device.baseline))
    return [
        replace(run, cotenants=cotenants(run.gpu, peers_of(alike[key_of(run)], idle_bytes=idle.get(_kind(run)))))
        if run.gpu
        else run
        for run in runs
    ]


def notes(runs: Sequence[Run]) -> list[str]:
    """What a reader must know beside throughput and memory: a sentence for each run with a co-tenant."""
    return [
        f"run {run.configuration.run_index}: another process was on the GPU "
        f"({described(run.cotenants.signs)}): the increment of GPU memory leaves this run out, and its throughput may "
        "be lower for it"
        for run in runs
        if run.cotenants.presence is Presence.SOME
    ]


def described(signs: Sequence[Sign]) -> str:
    """The signs of other processes, in words."""
    alike = gathered(((sign.processes, sign.by), sign) for sign in signs)
    return "; ".join(map(_signs_in_words, alike.values()))


def _signs_in_words(signs: Sequence[Sign]) -> str:
    first = signs[0]
    moments = ", ".join("timed steps" if sign.moment == TIMED else sign.moment for sign in signs)
    many = f"{first.processes} process{'es' if first.processes > 1 else ''}, " if first.processes else "about "
    held = [sign.bytes for sign in signs if sign.bytes is not None]
    return f"at {moments}: {many}{f'{max(held) / 1e9:.3g} GB' if held else 'bytes unknown'}, since {first.by}"


def _kind(recording: Run) -> str:
    gpu, host = recording.provenance.gpus[0], recording.provenance.host
    return json.dumps([*(gpu.get(name) for name in _KIND), *(host.get(name) for name in _MACHINE)], default=str)
