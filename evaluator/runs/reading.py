"""One file as the evaluation needs it: opened, checked, read and closed again."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.stamp import Stamp, stamp_of
from gpusimbench.evaluator.runs.run_data import RunData, read_run
from gpusimbench.evaluator.runs.summary import Summary, summarise
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.location import Place


@dataclass(frozen=True)
class Read:
    """A recording that was read.

    summary  what it says of itself
    run      what metrics need of it; None where the run did not end well or lost data
    stamp    of the file before it was read, where it was read; None without one that can be relied on
    """

    summary: Summary
    run: RunData | None
    stamp: Stamp | None = None


@dataclass(frozen=True)
class Unreadable:
    """A file that could not be opened or failed its checks, and why."""

    path: Place
    error: GsbError


@dataclass(frozen=True)
class Reader:
    """How files are read; a file that cannot be is a result too, so that the others are not lost with it.

    sample_time  simulated time at which positions are compared [s]
    verify       whether every byte is read and held against the digests
    """

    sample_time: float
    verify: bool = True

    def __call__(self, path: Place) -> Read | Unreadable:
        """Read one file, in memory that its size does not govern: see docs/scale.md."""
        stamp = stamp_of(path)
        try:
            recording = Recording(path)
            if self.verify:
                verify(recording)
            summary = summarise(recording)
            run = read_run(recording, summary, self.sample_time) if recording.usable else None
        except GsbError as error:
            return Unreadable(path, error)
        return Read(summary, run, stamp)
