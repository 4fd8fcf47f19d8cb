"""Recordings of given positions: real files, by the recorder's own writers, with an outcome known by construction."""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.evidence import EvidenceWriter
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.capture.states import StateWriter
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.schemas import topics
from gpusimbench.schemas.block_parts import encode_fingerprints
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import StateField, body_field
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import (
    PACKAGES,
    PROVENANCE,
    SCENE,
    SIMULATION,
    Buffer,
    Counter,
    OverflowBit,
    Provenance,
    ReplayOf,
)

described_scene = cache(make_scene)
"""A built-in scene by its name; thousands of recordings carry the same few."""


def cubes_field(dtype: str, *, frame: str = "world") -> StateField:
    """The position field of the 27 cubes."""
    names = described_scene("inclined-collision").groups()["cubes"]
    return replace(body_field("cubes", "position", dtype, names), frame=frame)


def changing(attachment: str, *path: str, **values: Any) -> Callable[[str, dict[str, Any]], None]:
    """For `change` of write_recording: other values in a JSON attachment, or in what a path of keys there leads to."""

    def change(name: str, record: dict[str, Any]) -> None:
        if name == attachment:
            for key in path:
                record = record[key]
            record |= values

    return change


def configured(**values: Any) -> Callable[[str, dict[str, Any]], None]:
    """The same of what a run was asked to do."""
    return changing(PROVENANCE, "configuration", **values)


@dataclass(frozen=True)
class Shown:
    """What a recording's steps show of their work.

    counts    by phase and counter: shape [row, env]
    overflow  by phase: bits, shape [row, env]
    bits      what they mean
    buffers   that the engine was given
    streams   by phase: messages of what was applied
    raw       topic, type and message of whatever else is to be written
    """

    counts: dict[str, dict[str, NDArray[np.integer]]] = field(default_factory=dict)
    overflow: dict[str, NDArray[np.uint32]] = field(default_factory=dict)
    bits: tuple[OverflowBit, ...] = ()
    buffers: tuple[Buffer, ...] = ()
    streams: dict[str, Any] = field(default_factory=dict)
    raw: tuple[tuple[str, str, Any], ...] = ()

    def proving(self, n_env: int, warmup: int, timed_steps: int) -> Shown:
        """The same with contacts at both ends of the timed phase, and hashes of states that differ."""
        begin = np.arange(n_env, dtype=np.uint64)
        block = encode_fingerprints(np.stack([begin, begin + np.uint64(n_env)]), first_step=warmup, stride=timed_steps)
        hashes = (topics.fingerprint("timed"), "gsb.v1.FingerprintBlock", block)
        counts = {"timed": {"contacts": np.full((2, n_env), 27)}, **self.counts}
        return replace(self, counts=counts, raw=(*self.raw, hashes))

    def counters(self) -> tuple[Counter, ...]:
        """Counters that are declared."""
        names = dict.fromkeys(name for by_name in self.counts.values() for name in by_name)
        return tuple(Counter(name, f"how many {name}") for name in names)

    def write(self, sink: Sink, description: Description, *, dt: float, timed_steps: int) -> None:
        """Write it as the recorder does: every captured step, of the timed phase rows far apart."""
        for phase in dict.fromkeys([*self.counts, *self.overflow]):
            stride = 1 if phase == "capture" else timed_steps
            writer = EvidenceWriter(sink, description, phase, dt=dt, stride=stride)
            writer.feed(
                Evidence(self.counts.get(phase, {}), self.overflow.get(phase)), first_step=1 if stride == 1 else stride
            )
        for phase, message in self.streams.items():
            sink.channel(topics.action_stream(phase), "gsb.v1.ActionStream")
            sink.write(topics.action_stream(phase), message.SerializeToString())
        for topic, kind, message in self.raw:
            sink.channel(topic, kind)
            sink.write(topic, message if isinstance(message, bytes) else message.SerializeToString())


NOTHING = Shown()


def _finish(sink: Sink, status: str, reason: str, **end: Any) -> Path:
    # thousands of these files would wait for the disk, and none of them is read after a power cut
    with mock.patch.object(os, "fsync"):
        return sink.finish(status, reason, **end)


def write_recording(
    folder: Path,
    final: NDArray[Any] | None,
    *,
    n_env: int = 1,
    run: int = 0,
    simulator: str = "synthetic",
    scene: str = "inclined-collision",
    steps: int = 5,
    dt: float = 1.0,
    status: str = "COMPLETE",
    reason: str = "",
    cause: str = "",
    elapsed_s: float | None = 1.0,
    timed_steps: int = 1000,
    warmup: int = 0,
    version: str = "1.0",
    gpu_bytes: tuple[int, int] | None = None,
    process_bytes: int | None = None,
    others: tuple[int | None, int | None] = (None, None),
    reserved: int | None = None,
    host_bytes: tuple[int, int] | None = None,
    allocator_peak: int | None = None,
    clocks: dict[str, float] | None = None,
    shown: Shown = NOTHING,
    origins: tuple[tuple[float, float, float], ...] = (),
    options: dict[str, Any] | None = None,
    in_force: dict[str, Any] | None = None,
    switches: dict[str, Any] | None = None,
    determinism: str = "default",
    built: bool = True,
    name: str | None = None,
    compression: str = "none",
    dropout: str = "",
    end: bool = True,
    stride: int = 1,
    change: Callable[[str, dict[str, Any]], Any] | None = None,
    field: StateField | None = None,
    environment: dict[str, str] | None = None,
    run_id: str | None = None,
    path_of: Callable[[NDArray[Any], int], NDArray[Any]] | None = None,
    begins: NDArray[Any] | None = None,
    whole: bool = False,
    cpu: str = "test",
    replay_of: ReplayOf | None = None,
    proven: bool = False,
) -> Path:
    """A recording whose cubes lie still until the last step and end at `final` [m], shape [env, 27, 3].

    final      None captures no states, of `n_env` environments
    elapsed_s  of the timed phase; None leaves it out
    gpu_bytes  baseline and peak on a GPU; None for a machine without
    process_bytes  of the process on the GPU in the timed phase; None where NVML did not tell
    others     processes beside it and their bytes, at the baseline and in the timed phase
    reserved   what the driver keeps for itself
    host_bytes the same of the process
    in_force   options that the engine had beside those that were asked for
    clocks     seconds of "build", "compile_timed", "compile_capture"
    built      False: the run ended before its simulator was there, and says nothing of it
    change     called with the name and content of each JSON attachment; may change it in place, or return other text
    whole      says all that the rules of integrity-1 ask of provenance
    proven     its throughput meets the protocol's rules: 100 warm-up steps, contacts, states that change while timing
    path_of    called with the initial positions and a step before the last; returns the positions then
    begins     the initial positions; None: the scene's
    """
    n_env = n_env if final is None else len(final)
    if proven:
        warmup = warmup or 100
        shown = shown.proving(n_env, warmup, timed_steps)
    dtype = "float32" if final is None else str(final.dtype)
    field = field or cubes_field(dtype)
    phases = tuple(name for name, there in (("timed", elapsed_s), ("capture", final is not None)) if there)
    configuration = RunConfiguration(
        simulator=simulator, scene=scene, n_env=n_env, dt=dt, steps=steps, run_index=run, warmup=warmup,
        timed_steps=timed_steps, phases=phases, stride=stride, determinism=determinism,
        options={name: str(value) for name, value in (options or {}).items()},
    )  # fmt: skip
    gpus = ({"name": "Test GPU", "driver": "1"},) if gpu_bytes else ()
    provenance = Provenance(
        run_id or str(uuid.uuid4()),
        "2026-01-01T00:00:00Z",
        ("test",),
        configuration,
        gpus=gpus,
        host={"cpu": cpu, **({"usable_threads": 2, "memory_bytes": 10**9, "system": "Linux"} if whole else {})},
        software={"python": "3", "recorder": {"version": "1"}, "packages": {"mcap": "1"}} if whole else {},
        environment=environment or {},
        replay_of=replay_of,
    )
    described = described_scene(scene)
    about = Description(
        version=version, device="Test GPU" if gpu_bytes else "cpu", options={**(options or {}), **(in_force or {})},
        switches=switches or {},
        deviations=(), fields=(field,), timing_covers="", env_origins=origins, buffers=shown.buffers,
        counters=shown.counters(), overflow_bits=shown.bits,
    )  # fmt: skip
    simulation = about.recorded(described, "rebuilt")
    path = folder / (name or f"{simulator}-{run}-{uuid.uuid4().hex[:8]}.mcap")
    sink = Sink(path, compression=compression)
    texts = {PROVENANCE: provenance.to_json(), SCENE: described.to_json()}
    if built:
        texts[SIMULATION] = simulation.to_json()
    for attachment, text in texts.items():
        if change is not None:
            record = json.loads(text)
            changed = change(attachment, record)
            if isinstance(changed, str):
                text = changed
            elif record != json.loads(text):  # what was left alone keeps its bytes, of which there are hashes
                text = json.dumps(record)
        sink.attach(attachment, "application/json", text.encode())
    if whole:
        sink.attach(PACKAGES, "text/plain", b"mcap==1\n")
    if not built:
        return _finish(sink, status, reason, last_step=0, peak_rss_bytes=0, cause=cause)
    for what, seconds in (clocks or {}).items():
        _write_timing(sink, what, seconds, 1)
    if elapsed_s:
        if warmup:
            _write_timing(sink, "warmup", elapsed_s, warmup)
        _write_timing(sink, "timed", elapsed_s, timed_steps, first_step=warmup)
    if gpu_bytes:
        told = {"other_processes": others[0], "other_bytes": others[1], "reserved_bytes": reserved}
        _write_memory(sink, topics.gpu_memory(0, "device"), 2, gpu_bytes, **told)
    if process_bytes is not None:
        _write_memory(sink, topics.gpu_memory(0, "process"), 3, (None, process_bytes))
    if host_bytes:
        _write_memory(sink, topics.MEMORY_HOST, 1, host_bytes)
    if allocator_peak:
        _write_memory(sink, topics.gpu_memory(0, "allocator"), 4, (0, allocator_peak), peak="peak until final")
    shown.write(sink, about, dt=dt, timed_steps=timed_steps)
    if final is not None:
        writer = StateWriter(sink, (field,), n_env=n_env, dt=dt, stride=stride)
        start = final  # of a field that is no position
        if final.shape[-1] == 3:
            start = np.broadcast_to(
                np.array([b.position for b in described.moving()[-final.shape[1] :]], dtype=dtype), final.shape
            )
        start = start if begins is None else begins
        writer.feed([start[np.newaxis]])
        between = [path_of(start, step) if path_of else start for step in range(1, steps)]
        writer.feed([np.stack([*between, final])])
        writer.flush()
    if dropout:
        sink.channel(topics.RUN_DROPOUT, "gsb.v1.Dropout")
        lost = message_class("gsb.v1.Dropout")(topic="/state", first_step=1, steps=2, reason=dropout)
        sink.write(topics.RUN_DROPOUT, lost.SerializeToString())
    if not end:
        sink.abandon()
        return sink.partial
    return _finish(sink, status, reason, last_step=steps if final is not None else 0, peak_rss_bytes=0, cause=cause)


def _write_timing(sink: Sink, phase: str, seconds: float, steps: int, *, first_step: int = 0) -> None:
    sink.channel(topics.timing(phase), "gsb.v1.StepTiming")
    timing = message_class("gsb.v1.StepTiming")(
        first_step=first_step, steps_per_interval=steps, start_ns=[0], end_ns=[round(seconds * 1e9)]
    )
    sink.write(topics.timing(phase), timing.SerializeToString())


def _write_memory(
    sink: Sink, topic: str, source: int, found: tuple[int | None, int], *, peak: str = "", **told: int | None
) -> None:
    """Readings at the baseline, in the timed phase and at its end; none at the baseline where that is None."""
    sink.channel(topic, "gsb.v1.MemorySample")
    last = () if peak else ((found[1], "", "final"),)
    for used, phase, checkpoint in ((found[0], "baseline", "baseline"), (found[1], "timed", peak), *last):
        if used is None:
            continue
        sample = message_class("gsb.v1.MemorySample")(
            source=source, monotonic_ns=1, used_bytes=used, phase=phase, checkpoint=checkpoint, **told
        )
        sink.write(topic, sample.SerializeToString())


def write_sweep(
    folder: Path,
    sizes: tuple[int, ...],
    *,
    runs: int = 2,
    fixed: float = 5e8,
    per_env: float = 1e6,
    speed: float = 1e5,
    fails: int | None = None,
    contacts: int = 27,
    **keywords: Any,
) -> list[Path]:
    """A sweep on a GPU that captures nothing: memory fixed + per_env * N, throughput `speed` at any N.

    fails  the N at which every run ends for want of device memory, before its simulator is built
    """
    written = []
    for n_env in sizes:
        counted = Shown(counts={"timed": {"contacts": np.full((2, n_env), contacts)}})
        for run in range(runs):
            failed = n_env == fails
            outcome: dict[str, Any] = (
                {"built": False, "status": "FAILED", "cause": "DEVICE_MEMORY", "reason": "no memory for the contacts"}
                if failed
                else {"shown": counted}
            )
            written.append(
                write_recording(
                    folder, None, n_env=n_env, run=run, timed_steps=1000, elapsed_s=n_env * 1000 / speed,
                    gpu_bytes=(10**9, 10**9 + round(fixed + per_env * n_env)), **{**outcome, **keywords},
                )
            )  # fmt: skip
    return written


def write_simulators(folder: Path, *names: str) -> None:
    """Two runs of each simulator, identical environments of the first and random ones of the others; and a sweep of one
    that fails at 16 environments."""
    rng = np.random.default_rng(3)
    for number, name in enumerate(names):
        for run in range(2):
            final = rng.uniform(0.0, 0.3, size=(3, 27, 3)) if number else grid(3)
            write_recording(folder, final, run=run, simulator=name, name=f"{number}-{run}.mcap", elapsed_s=1.0 + run)
    write_sweep(folder, (1, 4, 16), simulator=names[0], scene="free-fall", fails=16)


def grid(n_env: int, dtype: str = "float64") -> NDArray[Any]:
    """27 well separated positions on the board [m], the same in every environment, [env, 27, 3]."""
    x, y = np.meshgrid(np.linspace(0.1, 0.5, 9), np.array([-0.1, 0.0, 0.1]))
    one = np.column_stack([x.ravel(), y.ravel(), np.full(27, 0.03)])
    return np.broadcast_to(one, (n_env, 27, 3)).astype(dtype).copy()


def metrics_of(text: str, label: int = 0) -> dict[str, Any]:
    """The metrics of one group of a JSON result."""
    return json.loads(text)["groups"][label]["metrics"]
