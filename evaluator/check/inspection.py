"""The facts of one recording that a person asks first: who made it, of what, where, how long, and what is in it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

from gpusimbench.evaluator.check.hardware import Hardware, hardware_of
from gpusimbench.evaluator.check.integrity import Integrity
from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.evaluator.check.integrity.scan import Scan
from gpusimbench.evaluator.metrics.cotenants import Sign, cotenants
from gpusimbench.evaluator.metrics.throughput import frames_per_second
from gpusimbench.evaluator.read.episodes import EpisodeCounts, count_episodes
from gpusimbench.evaluator.read.failing import Failing
from gpusimbench.evaluator.read.known_errors import known_errors
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.memory import gpu_memory
from gpusimbench.schemas import topics
from gpusimbench.schemas.errors import NUMBERS_OF_A_STRANGER, GsbError, NotARecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import Provenance, Simulation
from gpusimbench.schemas.view.recorded import LOG_TOPIC

_T = TypeVar("_T")


@dataclass(frozen=True)
class Array:
    """A recorded array.

    shape         of the whole array; empty where the file does not tell
    bytes         of the numbers
    stored_bytes  of the messages that hold them, before chunks are compressed
    encodings     numbers of the encodings of its blocks; 0 is the array as it is
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    unit: str
    frame: str
    note: str
    bytes: int
    stored_bytes: int
    encodings: tuple[int, ...]


@dataclass(frozen=True)
class Rate:
    """Steps of all environments in a time: env_steps_per_s = n_env * steps * times / seconds.

    first_step  steps that were made before
    times       how often the same steps were made and timed
    """

    n_env: int
    steps: int
    seconds: float
    env_steps_per_s: float
    first_step: int = 0
    times: int = 1


@dataclass(frozen=True)
class Memory:
    """Readings of one source [byte]; None where there is none. `peak` is the largest of all phases."""

    readings: int
    baseline: int | None
    peak: int
    total: int | None


@dataclass(frozen=True)
class CoTenancy:
    """Other processes on the device that the simulator stepped on, as far as this file alone tells.

    presence  "none", "some" or "unknown"
    signs     what says that they were there
    """

    presence: str
    signs: tuple[Sign, ...]


@dataclass(frozen=True)
class Container:
    """How the file is made: size, writer, chunks by compression, their bytes before and after."""

    bytes: int
    library: str
    chunks: dict[str, int]
    stored_bytes: int
    unpacked_bytes: int


@dataclass(frozen=True)
class Inspection:
    """What can be said of one file.

    integrity    problems by kind, one sentence each; empty where nothing is wrong
    doubtful     attachments that are not what was recorded: what is told of them may be wrong
    verified     whether the digests and all else that needs the whole content were looked at
    known_errors  of the recorder that made it: what is wrong in the file, a sentence each
    unread       what could not be read, and why
    unchecked    kinds of problems that were not looked for, or not everywhere, and why
    phases       that began and ended, with their durations [s]
    clocks       phases that have clocks, with how many intervals of how many steps
    timed_missing, captured_missing  why there is no throughput, and no rate of captured steps
    hardware     clock rates and the like by where they are of: host, gpu0, ...
    co_tenants   other processes on the device; None where the simulator did not step on a GPU
    counters     names by phase
    hashes       steps with state hashes, by phase
    failing      environments that failed; None where the states of all were kept
    overflowed   buffers and limits that were run into; None where the engine does not tell
    episodes     of the environments of a task; None where the recording has none, or they cannot be read
    program      updates of the arrays that a program hashed, by name
    view         environments that viewers show of the file, as it is
    """

    file: str
    container: Container | None
    status: str
    reason: str
    cause: str
    content_hash: str
    integrity: dict[str, tuple[str, ...]]
    verified: bool
    provenance: Provenance | None = None
    simulation: Simulation | None = None
    phases: dict[str, float] = field(default_factory=dict)
    clocks: dict[str, tuple[int, int]] = field(default_factory=dict)
    timed: Rate | None = None
    timed_missing: str = ""
    captured: Rate | None = None
    captured_missing: str = ""
    memory: dict[str, Memory] = field(default_factory=dict)
    hardware: dict[str, Hardware] = field(default_factory=dict)
    co_tenants: CoTenancy | None = None
    peak_rss_bytes: int | None = None
    arrays: tuple[Array, ...] = ()
    actions: tuple[Array, ...] = ()
    counters: dict[str, tuple[str, ...]] = field(default_factory=dict)
    hashes: dict[str, int] = field(default_factory=dict)
    gates: tuple[str, ...] = ()
    failing: Failing | None = None
    overflowed: tuple[str, ...] | None = None
    dropouts: tuple[str, ...] = ()
    episodes: EpisodeCounts | None = None
    program: dict[str, int] = field(default_factory=dict)
    view: tuple[int, ...] = ()
    attachments: dict[str, int] = field(default_factory=dict)
    doubtful: tuple[str, ...] = ()
    known_errors: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    unchecked: dict[str, str] = field(default_factory=dict)


def inspect(file: Integrity) -> Inspection:
    """Whatever can be said of an examined file. NotARecording where that is nothing."""
    if file.scan is None:
        raise NotARecording(file.not_opened)
    recording = file.recording
    found = Inspection(
        file=str(file.path),
        container=_container(file.scan),
        status=recording.status if recording else "unreadable",
        reason=recording.reason if recording else file.not_opened,
        cause=recording.cause if recording else "",
        content_hash=str(file.end.content_hash) if file.end is not None else "",
        integrity={kind.name: file.of(kind) for kind in file.problems.kinds()},
        verified=file.complete,
        unchecked={kind.name: why for kind in Kind if (why := file.problems.skipped(kind))},
        provenance=file.provenance,
        simulation=file.simulation,
        doubtful=tuple(sorted(file.scan.doubtful)),
        known_errors=tuple(error.said for error in known_errors(recording)) if recording else (),
        attachments={name: len(data) for name, data in file.scan.attachments.items()},
        peak_rss_bytes=(int(file.end.peak_rss_bytes) or None) if file.end is not None else None,
    )
    return _with_streams(found, recording, file.scan) if isinstance(recording, Recording) else found


def _container(scan: Scan) -> Container:
    return Container(
        scan.size, scan.library, {name or "none": n for name, n in scan.compressions.items()},
        scan.stored, scan.unpacked,
    )  # fmt: skip


def _with_streams(found: Inspection, recording: Recording, scan: Scan) -> Inspection:
    """The same with what its streams hold; what cannot be read stays as in `found`, and the reason is told."""
    unread: dict[str, None] = {}

    def read(what: Callable[[Recording], _T], otherwise: _T) -> _T:
        try:
            return what(recording)
        except GsbError as error:
            unread.setdefault(str(error))
        except NUMBERS_OF_A_STRANGER as error:
            unread.setdefault(str(error) or type(error).__name__)
        return otherwise

    phases = read(_phases, found.phases)
    unread_clocks: tuple[Rate | None, str] = (None, "its clocks cannot be read")
    timed, timed_missing = read(_timed, unread_clocks)
    captured, captured_missing = read(lambda r: _captured(r, phases), unread_clocks)
    of_streams = replace(
        found,
        phases=phases,
        clocks=read(lambda r: {n: (len(t.start_ns), t.steps_per_interval) for n, t in r.timing.items()}, found.clocks),
        timed=timed,
        timed_missing=timed_missing,
        captured=captured,
        captured_missing=captured_missing,
        memory=read(_memory, found.memory),
        hardware=read(hardware_of, found.hardware),
        co_tenants=read(_co_tenants, None),
        arrays=tuple(a for field in recording.fields if (a := read(partial(_state, scan=scan, field=field), None))),
        actions=tuple(_action(scan, name) for name in recording.action_names),
        counters=read(lambda r: {phase: tuple(by_name) for phase, by_name in r.counts.items()}, found.counters),
        hashes=read(_hashes, found.hashes),
        failing=read(lambda r: r.failing, None),
        gates=read(lambda r: tuple(f"{e.phase}: {e.text}" for e in r.events if e.kind == "GATE"), found.gates),
        overflowed=read(_overflowed, None),
        dropouts=read(lambda r: r.dropouts, found.dropouts),
        episodes=read(count_episodes, None),
        program=read(lambda r: {name: len(updates.order) for name, updates in r.program.items()}, found.program),
        view=_shown(scan),
    )
    return replace(of_streams, unread=tuple(unread))


def _shown(scan: Scan) -> tuple[int, ...]:
    found = (topics.parse_view(topic) for topic in scan.streams if topic != LOG_TOPIC)
    return tuple(sorted({parts.env for parts in found if parts is not None}))


def _phases(recording: Recording) -> dict[str, float]:
    began = {event.phase: event.monotonic_ns for event in recording.events if event.kind == "PHASE_BEGIN"}
    return {
        event.phase: (event.monotonic_ns - began[event.phase]) * 1e-9
        for event in recording.events
        if event.kind == "PHASE_END" and event.phase in began
    }


def _timed(recording: Recording) -> tuple[Rate | None, str]:
    c = recording.configuration
    timing = recording.timing.get("timed")
    if "timed" not in c.phases:
        return None, "no timed phase was asked for"
    if timing is None:
        return None, "the run ended before its timed phase did"
    times = timing.times_of(c.timed_steps)
    if times is None:
        return None, f"its clocks are not those of {c.timed_steps} steps"
    fps = frames_per_second(c.n_env, times * c.timed_steps, timing.elapsed_s)
    return Rate(c.n_env, c.timed_steps, timing.elapsed_s, fps, timing.first_step, times), ""


def _captured(recording: Recording, phases: dict[str, float]) -> tuple[Rate | None, str]:
    c, clock = recording.configuration, recording.timing.get("capture")
    seconds = clock.elapsed_s if clock else phases.get("capture", 0.0)  # older files have no clock of their own
    if "capture" not in c.phases:
        return None, "no capture phase was asked for"
    if seconds <= 0 or recording.status != "complete":
        return None, "the capture phase has no clocks" if recording.status == "complete" else "the run is not complete"
    made = c.captured_steps
    return Rate(c.n_env, made, seconds, frames_per_second(c.n_env, made, seconds), c.first_step), ""


def _memory(recording: Recording) -> dict[str, Memory]:
    return {
        source: Memory(trace.readings, trace.at("baseline"), int(trace.used_bytes.max()), trace.total_bytes or None)
        for source, trace in recording.memory.items()
    }


def _co_tenants(recording: Recording) -> CoTenancy | None:
    memory = gpu_memory(recording)
    if not memory:
        return None
    found = cotenants(memory)
    return CoTenancy(found.presence.value, found.signs)


def _state(recording: Recording, scan: Scan, field: StateField) -> Array | None:
    array = recording.state(field.group, field.field)
    streams = [scan.streams[topic] for topic in topics.states_of(scan.streams, field.group, field.field)]
    return Array(
        field.name, array.shape, field.dtype, _unit(field), field.frame, field.note,
        math.prod(array.shape, start=array.dtype.itemsize), sum(s.bytes for s in streams),
        tuple(sorted({e for s in streams for e in s.encodings})),
    )  # fmt: skip


def _unit(field: StateField) -> str:
    if not field.item_units:
        return field.unit
    return ", ".join(f"{unit} ({count})" for unit, count in Counter(field.item_units).items())


def _action(scan: Scan, name: str) -> Array:
    # what is stored is told without reading it: actions of a long run are large
    streams = [stream for topic, stream in scan.streams.items() if (p := topics.parse_action(topic)) and p.name == name]
    stored = sum(stream.bytes for stream in streams)
    return Array(name, (), "", "", "", "", 0, stored, ())


def _hashes(recording: Recording) -> dict[str, int]:
    found = {phase: recording.fingerprints(phase) for phase in ("timed", "capture")}
    return {phase: len(hashes.steps) for phase, hashes in found.items() if hashes is not None}


def _overflowed(recording: Recording) -> tuple[str, ...] | None:
    if not recording.overflows:
        return None
    described = recording.simulation.overflow_bits if recording.simulation else ()
    names = {bit.bit: f"{bit.name}{'' if bit.fatal else ' (harmless)'}" for bit in described}
    return tuple(
        f"{names.get(bit, f'bit {bit}')} in {phase}, at {int(fired.sum())} of {len(fired)} recorded steps"
        for phase, overflows in recording.overflows.items()
        for bit in range(32)
        if (fired := overflows.rows_of(bit)).any()
    )
