"""Streams of a run that say how it went: clocks, memory, state hashes, events."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.memory import allocator_peak
from gpusimbench.evaluator.read.messages import MAX_NOTES, Columns, Messages
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import decode_fingerprints
from gpusimbench.schemas.checks import MAX_COUNT
from gpusimbench.schemas.messages import enum_values
from gpusimbench.schemas.treatment import Intervention

_MAX_BYTES = 1 << 62
_MAX_NS = 1 << 62  # differences of clocks stay within an int64
_PEAK = "peak until "


@dataclass(frozen=True)
class StepTiming:
    """Clocks of a phase.

    first_step          simulator step that the first interval begins with
    steps_per_interval  simulator steps per interval
    start_ns, end_ns    host's monotonic clock at the beginning and end of each interval [ns], shape [interval]
    windows             the same steps may be timed several times: the first interval of each time
    """

    first_step: int
    steps_per_interval: int
    start_ns: NDArray[np.int64]
    end_ns: NDArray[np.int64]
    windows: tuple[int, ...] = (0,)

    @property
    def elapsed_s(self) -> float:
        """The time from the first begin to the last end of each window, summed over windows [s]."""
        ends = (*(first - 1 for first in self.windows[1:]), -1)
        begins = list(self.windows)
        return float((self.end_ns[list(ends)] - self.start_ns[begins]).sum()) * 1e-9

    @property
    def window_s(self) -> float:
        """Mean duration of a window, which has the timed steps once [s]."""
        return self.elapsed_s / len(self.windows)

    @property
    def first_end_ns(self) -> int:
        """The end of the first window [ns]."""
        return int(self.end_ns[self.windows[1] - 1 if len(self.windows) > 1 else -1])

    def times_of(self, steps: int) -> int | None:
        """How many times so many steps were timed; None where the intervals are of other steps."""
        intervals = -(-steps // self.steps_per_interval) if self.steps_per_interval else 0  # the last may be shorter
        times = len(self.windows)
        alike = self.windows == tuple(range(0, times * intervals, max(intervals, 1)))
        return times if intervals and alike and len(self.start_ns) == times * intervals else None

    @property
    def total_s(self) -> float:
        """The time of all intervals, without what lies between them [s]."""
        return float((self.end_ns - self.start_ns).sum()) * 1e-9


_SAMPLE = {
    3: ("monotonic_ns", "fixed64"),
    4: ("used_bytes", "uint64"),
    5: ("total_bytes", "uint64"),
    8: ("other_processes", "uint32"),
    9: ("other_bytes", "uint64"),
    10: ("reserved_bytes", "uint64"),
    11: ("omitted_readings", "uint32"),
}
"""Numbers of a MemorySample by their field."""

_Others = tuple[int | None, int | None]
_UNTOLD: _Others = (None, None)


@dataclass(frozen=True)
class MemoryTrace:
    """Readings of one memory source, in order of time; of equal ones in a row, perhaps the first and last alone.

    time_ns      host's monotonic clock, shape [sample]
    used_bytes   shape [sample]
    phase        of the run, one per sample
    checkpoint   name of the protocol's checkpoint, or empty, one per sample
    total_bytes  capacity, 0 where unknown
    others       processes beside the run's own and their bytes, None where either is unknown, one per sample; empty
                 where no sample tells
    omitted      readings between the sample before and this one that are not here since both are equal to them, shape
                 [sample]
    reserved     what the driver keeps for itself [byte], by checkpoint
    """

    time_ns: NDArray[np.int64]
    used_bytes: NDArray[np.int64]
    phase: tuple[str, ...]
    checkpoint: tuple[str, ...]
    total_bytes: int
    omitted: NDArray[np.int64]
    others: tuple[_Others, ...] = ()
    reserved: dict[str, int] = field(default_factory=dict)

    @property
    def readings(self) -> int:
        """How many readings were taken."""
        return len(self.time_ns) + int(self.omitted.sum())

    def most_others(self, *, checkpoint: str = "", phase: str = "") -> tuple[int, int | None] | None:
        """The most processes beside the run's own at a checkpoint, or in a phase, and the most bytes that they held.

        None where there is no reading, and where a reading does not tell the processes, unless another one lists some.
        """
        wanted = self.checkpoint if checkpoint else self.phase
        found = [o for name, o in zip(wanted, self.others, strict=False) if name == (checkpoint or phase)]
        counts = [count for count, _ in found if count is not None]
        if not any(counts) and (not counts or len(counts) < len(found)):
            return None
        return max(counts), max((used for _, used in found if used is not None), default=None)

    def at(self, checkpoint: str) -> int | None:
        """Bytes in use at a checkpoint, None where it was not reached."""
        for name, used in zip(self.checkpoint, self.used_bytes, strict=True):
            if name == checkpoint:
                return int(used)
        return None

    def peak(self, phase: str, until_ns: int) -> int | None:
        """Largest reading of a phase up to a time on the monotonic clock; the first one behind, where there is none.

        None where the phase has no reading. What an engine does behind its last step, such as handing over its state,
        is none of the phase's memory.
        """
        found = [
            (int(t), int(u)) for t, u, p in zip(self.time_ns, self.used_bytes, self.phase, strict=True) if p == phase
        ]
        inside = [used for time, used in found if time <= until_ns]
        return max(inside, default=found[0][1] if found else None)

    def own_peak(self) -> int | None:
        """Largest peak that the source itself kept, as an allocator does.

        None where it keeps none, and where it was reached while the simulator was built: then it is the memory of a
        compiler or a loader, and that of the simulation was smaller.
        """
        kept = [(c, int(u)) for c, u in zip(self.checkpoint, self.used_bytes, strict=True) if c.startswith(_PEAK)]
        built = max((used for name, used in kept if name == f"{_PEAK}post-init"), default=None)
        return allocator_peak(built, [used for _, used in kept])


@dataclass(frozen=True)
class Fingerprints:
    """State hashes of a phase.

    steps   simulator step of each row, shape [row]
    hashes  shape [row, env]
    """

    steps: NDArray[np.int64]
    hashes: NDArray[np.uint64]


def of_both_phases(
    timed: Fingerprints | None, captured: Fingerprints | None, intervention: str
) -> tuple[NDArray[np.int64], NDArray[np.uint64], NDArray[np.uint64]]:
    """State hashes of the timed and the captured phase where they must agree: at the steps that both passed, up to the
    intervention of a RunConfiguration, which is made in the capture alone.

    Steps [row], and hashes [row, env] of each phase; no rows where a phase has none.
    """
    if timed is None or captured is None:
        none = np.empty((0, 0), dtype=np.uint64)
        return np.empty(0, dtype=np.int64), none, none
    steps, at_timed, at_captured = np.intersect1d(timed.steps, captured.steps, return_indices=True)
    done = Intervention.of(intervention)
    rows = slice(None if done is None else int(np.searchsorted(steps, done.step, side="right")))
    return steps[rows], timed.hashes[at_timed[rows]], captured.hashes[at_captured[rows]]


@dataclass(frozen=True)
class Event:
    """A moment of the run: its kind (PHASE_BEGIN, PHASE_END, NOTE, GATE), phase, clocks and text."""

    kind: str
    phase: str
    monotonic_ns: int
    unix_ns: int
    text: str


def read_timing(messages: Messages) -> dict[str, StepTiming]:
    """Clocks by phase ("warmup", "timed", "build", "compile_timed", "compile_capture")."""
    found = {}
    for topic in messages.topics("/timing/"):
        parts = messages.read(topic, "gsb.v1.StepTiming")
        if not parts:
            continue
        start = np.concatenate([np.fromiter(p.start_ns, np.int64, len(p.start_ns)) for p in parts])
        end = np.concatenate([np.fromiter(p.end_ns, np.int64, len(p.end_ns)) for p in parts])
        if len(start) != len(end):
            raise messages.damaged(f"{topic} has {len(start)} begins and {len(end)} ends")
        if not len(start):
            continue  # a phase of no steps
        parts = [p for p in parts if len(p.start_ns)]
        if min(start.min(), end.min()) < -_MAX_NS or max(start.max(), end.max()) > _MAX_NS:
            raise messages.damaged(f"{topic} has a time that no clock shows")
        if len({p.steps_per_interval for p in parts}) > 1 or parts[0].first_step > MAX_COUNT:
            raise messages.damaged(f"{topic} has intervals of different or impossible numbers of steps")
        # what takes less than a tick of the clock, such as compiling nothing, ends when it begins
        if (
            (end < start).any()
            or (start[1:] < end[:-1]).any()
            or end[-1] - start[0] < (topic == topics.timing("timed"))
        ):
            raise messages.damaged(f"the clock of {topic} went backwards")
        name = topic.removeprefix("/timing/")
        at = np.cumsum([0, *(len(p.start_ns) for p in parts)])[:-1]
        windows = tuple(int(i) for i, p in zip(at, parts, strict=True) if p.first_step == parts[0].first_step)
        found[name] = StepTiming(parts[0].first_step, parts[0].steps_per_interval, start, end, windows)
    return found


def read_memory(messages: Messages) -> dict[str, MemoryTrace]:
    """Memory readings by source: "host", "gpu0/device", "gpu0/process", "gpu0/allocator", ..."""
    found = {}
    for topic in messages.topics("/memory/"):
        # hours of readings are many: nothing but numbers is kept of each, and one text for all that have it
        times, used, total = list[NDArray[np.int64]](), list[NDArray[np.int64]](), 0
        omitted = list[NDArray[np.int64]]()
        phases, checkpoints, texts = list[str](), list[str](), dict[str, str]()
        others, kept, reserved = list[_Others](), dict[_Others, _Others](), dict[str, int]()
        for part in messages.columns(topic, "gsb.v1.MemorySample", _SAMPLE):
            numbers, which = part.numbers, part.which.tolist()
            if max(numbers[name].max() for name in ("used_bytes", "other_bytes", "reserved_bytes")) >= _MAX_BYTES:
                raise messages.damaged(f"{topic} has a reading that no memory can have")
            times.append(numbers["monotonic_ns"].view(np.int64))
            used.append(numbers["used_bytes"].astype(np.int64))
            total = int(numbers["total_bytes"][-1])
            omitted.append(numbers["omitted_readings"].astype(np.int64))
            shapes = [
                _Shape(texts.setdefault(s.phase, s.phase), texts.setdefault(s.checkpoint, s.checkpoint), s)
                for s in part.parsed
            ]
            phases += [shapes[shape].phase for shape in which]
            checkpoints += [shapes[shape].checkpoint for shape in which]
            others += _others(part, kept)
            for place, shape in enumerate(which):
                if shapes[shape].checkpoint and shapes[shape].sample.HasField("reserved_bytes"):
                    reserved[checkpoints[place - len(which)]] = int(numbers["reserved_bytes"][place])
        if times:
            found[topic.removeprefix("/memory/")] = MemoryTrace(
                np.concatenate(times),
                np.concatenate(used),
                tuple(phases),
                tuple(checkpoints),
                total,
                np.concatenate(omitted),
                tuple(others) if set(kept) != {_UNTOLD} else (),
                reserved,
            )
    return found


class _Shape(NamedTuple):
    phase: str
    checkpoint: str
    sample: Any


def _others(part: Columns, kept: dict[_Others, _Others]) -> list[_Others]:
    told = [(s.HasField("other_processes"), s.HasField("other_bytes")) for s in part.parsed]
    if not any(chain.from_iterable(told)):
        return [kept.setdefault(_UNTOLD, _UNTOLD)] * len(part.which)
    numbers = part.numbers["other_processes"].tolist(), part.numbers["other_bytes"].tolist()
    found = list[_Others]()
    for shape, count, used in zip(part.which.tolist(), *numbers, strict=True):
        counted, known = told[shape]
        present = (count if counted else None, used if known else None)
        found.append(kept.setdefault(present, present))
    return found


def read_fingerprints(messages: Messages, phase: str, *, n_env: int, cut_short: bool) -> Fingerprints | None:
    """State hashes of a phase; None where it has none. Rows that lack environments are left out of a file cut short."""
    topic = topics.fingerprint(phase)
    if not messages.has(topic):
        return None
    most = messages.content_bytes // (n_env * np.dtype(np.uint64).itemsize)
    rows: dict[int, NDArray[np.uint64]] = {}
    filled: dict[int, int] = {}
    for content in messages.contents(topic):
        header, block = decode_fingerprints(content)
        stop = header.env_start + header.envs
        last = header.first_step + header.steps * header.stride
        if not block.size or stop > n_env or last > MAX_COUNT or (header.steps > 1 and header.stride < 1):
            raise messages.damaged(f"a block of {topic} has environments or steps that cannot be")
        for row, hashes in enumerate(block):
            step = header.first_step + row * header.stride
            if step not in rows and len(rows) == most:
                raise messages.damaged(
                    f"{topic} has more steps of {n_env} environments than the file can hold hashes of"
                )
            whole = rows.setdefault(step, np.zeros(n_env, dtype=np.uint64))
            whole[header.env_start : stop] = hashes
            filled[step] = filled.get(step, 0) + header.envs
    if not rows:
        return None
    if set(filled.values()) != {n_env}:
        if not cut_short or max(filled.values()) > n_env:
            raise messages.damaged(f"{topic} does not cover every environment once at every step")
        rows = {step: hashes for step, hashes in rows.items() if filled[step] == n_env}
        if not rows:
            return None
    steps = sorted(rows)
    return Fingerprints(np.array(steps, dtype=np.int64), np.stack([rows[step] for step in steps]))


def read_events(messages: Messages) -> tuple[Event, ...]:
    """Phases, notes and gates, in order."""
    names = {number: name.removeprefix("EVENT_KIND_") for name, number in enum_values("gsb.v1.EventKind").items()}
    return tuple(
        Event(names.get(e.kind, "UNSPECIFIED"), e.phase, e.monotonic_ns, e.unix_ns, e.text)
        for e in messages.read(topics.RUN_EVENT, "gsb.v1.Event", MAX_NOTES)
    )


def read_dropouts(messages: Messages) -> tuple[str, ...]:
    """One sentence for each stretch of data that the recorder says was lost."""
    return tuple(
        f"{d.topic}: {d.steps} steps from step {d.first_step}: {d.reason}"
        for d in messages.read(topics.RUN_DROPOUT, "gsb.v1.Dropout", MAX_NOTES)
    )
