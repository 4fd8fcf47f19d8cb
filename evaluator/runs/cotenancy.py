"""Other processes on the device, as far as all runs together tell; and what a reader must know of them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

from gpusimbench.evaluator.metrics.cotenants import TIMED, Presence, Sign, cotenants, peers_of
from gpusimbench.evaluator.metrics.memory import GpuMemory
from gpusimbench.evaluator.runs.groups import key_of
from gpusimbench.evaluator.runs.run import Run

_KIND = ("name", "driver", "cuda_driver", "memory_bytes", "compute_capability", "ecc", "mig", "persistence_mode")
"""What the driver keeps for itself depends on, of a GPU."""

_MACHINE = ("cpu", "memory_bytes")
"""The same of the host, by which machines of another kind are told apart."""


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
    alike: dict[tuple[int | None, str], list[Sign]] = {}
    for sign in signs:
        alike.setdefault((sign.processes, sign.by), []).append(sign)
    return "; ".join(map(_said, alike.values()))


def _said(signs: Sequence[Sign]) -> str:
    first = signs[0]
    moments = ", ".join("timed steps" if sign.moment == TIMED else sign.moment for sign in signs)
    many = f"{first.processes} process{'es' if first.processes > 1 else ''}, " if first.processes else "about "
    held = [sign.bytes for sign in signs if sign.bytes is not None]
    return f"at {moments}: {many}{f'{max(held) / 1e9:.3g} GB' if held else 'bytes unknown'}, since {first.by}"


def _kind(recording: Run) -> str:
    gpu, host = recording.provenance.gpus[0], recording.provenance.host
    return json.dumps([*(gpu.get(name) for name in _KIND), *(host.get(name) for name in _MACHINE)], default=str)
