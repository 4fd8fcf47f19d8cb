"""What shows whether a run becomes slower or larger with the steps that it makes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.streams import MemoryTrace, StepTiming
from gpusimbench.evaluator.runs.validation import NOT_TIMED

_PARTS = 10  # of a window
_MEMORY_PARTS = 6
_WINDOWS = 64


@dataclass(frozen=True)
class Course:
    """The timed phase of one run from its begin to its end.

    seconds  from the first clock reading to the last [s]
    windows  how long the same steps took, each time that they were timed [s]; of many, means of neighbours
    parts    time of a step in tenths of the window, mean over windows [s]; empty where fewer intervals were clocked
    work     what was counted at the first and at the last timed step, mean over environments, by counter
    stepped  all windows together [s], without what lies between them
    host     memory of the process [byte]: in the middle of the first window, and after each sixth of the second halves
             of all windows, without what it took elsewhere; empty where it was not read
    device   the same of its memory on the GPU
    """

    seconds: float
    windows: tuple[float, ...]
    parts: tuple[float, ...]
    work: dict[str, tuple[float, float]] = field(default_factory=dict)
    stepped: float = 0.0
    host: tuple[int, ...] = ()
    device: tuple[int, ...] = ()


def course_of(recording: Recording) -> Course | Missing:
    """Of a recording whose clocks are those of the steps that were asked for."""
    timing = recording.timing.get("timed")
    if timing is None:
        return NOT_TIMED
    windows = len(timing.windows)
    begin, end = timing.start_ns.reshape(windows, -1), timing.end_ns.reshape(windows, -1)
    each = (end[:, -1] - begin[:, 0]) * 1e-9
    few = min(windows, _WINDOWS)
    counts = recording.counts.get("timed", {})
    return Course(
        seconds=float(end[-1, -1] - begin[0, 0]) * 1e-9,
        windows=tuple(float(part.mean()) for part in np.array_split(each, few)),
        parts=_parts(timing, recording.configuration.timed_steps),
        work={name: (float(c.mean[0]), float(c.mean[-1])) for name, c in counts.items() if len(c.mean) > 1},
        stepped=float(each.sum()),
        host=_late_in_windows(recording.memory.get("host"), timing),
        device=_late_in_windows(recording.memory.get("gpu0/process"), timing),
    )


def _parts(timing: StepTiming, steps: int) -> tuple[float, ...]:
    windows = len(timing.windows)
    taken = ((timing.end_ns - timing.start_ns) * 1e-9).reshape(windows, -1).mean(axis=0)
    if len(taken) < _PARTS:
        return ()
    made = np.full(len(taken), timing.steps_per_interval)
    made[-1] = steps - timing.steps_per_interval * (len(taken) - 1)  # the last interval may be shorter
    split = (np.array_split(values, _PARTS) for values in (taken, made))
    return tuple(float(seconds.sum() / n.sum()) for seconds, n in zip(*split, strict=True))


def _late_in_windows(trace: MemoryTrace | None, timing: StepTiming) -> tuple[int, ...]:
    """See Course.host. A reset, or the first call after it, may take memory, however many steps follow."""
    if trace is None:
        return ()
    windows = len(timing.windows)
    begin, end = timing.start_ns.reshape(windows, -1)[:, :1], timing.end_ns.reshape(windows, -1)[:, -1:]
    pieces = -(-_MEMORY_PARTS // windows)
    middle = (begin + end) // 2
    ends = middle + (end - middle) * np.arange(pieces + 1) // pieces
    rows = (
        np.searchsorted(trace.time_ns, ends, side="right") - 1
    )  # the last reading, which may have been equal for long
    if rows[0, 0] < 0:
        return ()
    used = np.asarray(trace.used_bytes, dtype=np.int64)[rows]
    added = [int(part.sum()) for part in np.array_split(np.diff(used, axis=1).ravel(), _MEMORY_PARTS)]
    return tuple(int(used[0, 0]) + sum(added[:parts]) for parts in range(_MEMORY_PARTS + 1))
