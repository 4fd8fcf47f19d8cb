"""How far a set of runs is, and how much time is left: by the runs that have ended, and by steps of the present one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from gpusimbench.schemas.commands.progress import duration

COMPILE, REBUILD = "compile", "rebuild"
BETWEEN = (COMPILE, REBUILD)
"""Reported beside the phases of a recording, of which they are parts: an engine compiles, or is built anew."""

_WORDS = {
    "start": "starting",
    "baseline": "starting",
    "init": "building",
    REBUILD: "building anew",
    COMPILE: "compiling",
    "warmup": "warm-up",
    "timed": "timed steps",
    "capture": "capture",
    "ending": "writing the end",
}


Report = Callable[[str, int, int], None]
"""Called with a phase of a run, the steps done in it, and those that it has; with interruption.ENDING at the end."""


@dataclass
class _Present:
    """A run that is being made: since when, and where it is.

    expected  seconds that its phase will take at least roughly; None where nobody knows
    """

    began: float
    phase: str = "start"
    done: int = 0
    of: int = 0
    since: float = 0.0
    expected: float | None = None


class Pace:
    """Runs of a set that have ended or are being made. Times are in seconds, of any clock.

    runs  of the whole set, and how many of them were there before
    """

    def __init__(self, runs: int, there: int, now: float) -> None:
        self._runs = runs
        self._ended = there
        self._took: list[float] = []
        self._began = now
        self._present: dict[int, _Present] = {}

    def update(self, run: int, phase: str, done: int, of: int, now: float) -> None:
        """A run has done so many steps of a phase."""
        present = self._present.setdefault(run, _Present(self._began, since=self._began))
        if phase != present.phase:
            present.expected = self._of_timed_phase(present, of, now) if phase == "timed" else None
            present.since = now
        present.phase, present.done, present.of = phase, done, of

    def finish(self, run: int, now: float, elapsed: float | None = None) -> float:
        """A run has ended; returns how long it took [s]: `elapsed`, or since the one before it ended."""
        took = now - self._began if elapsed is None else elapsed
        self._present.pop(run, None)
        self._took.append(took)
        self._ended += 1
        self._began = now
        return took

    def left(self, now: float) -> float | None:
        """How long the runs that are not ended will take [s].

        None while none has ended, where none is left, and once the last takes longer than those before it.
        """
        remaining = self._runs - self._ended
        if not self._took or remaining <= 0:
            return None
        each = sum(self._took) / len(self._took)
        spent = sum(min(now - present.began, each) for present in list(self._present.values()))
        if not self._present:
            spent = min(now - self._began, each)
        left = (each * remaining - spent) / max(1, len(self._present))
        return left if left > 0 else None

    def words(self, now: float) -> str:
        """Which run is made, where it is, how long that has taken, and what is left."""
        if self._ended >= self._runs:
            return ""
        run, present = min(list(self._present.items()), default=(None, _Present(self._began, since=self._began)))
        number = self._ended + 1 if run is None else run + 1
        others = f" (and {len(self._present) - 1} more at once)" if len(self._present) > 1 else ""
        said = f"run {number}/{self._runs}{others}: {_WORDS.get(present.phase, present.phase)}"
        if present.of > 1:
            said += f", {present.done} of {present.of} steps" if present.done else f", {present.of} steps"
        said += f", {duration(now - present.since)} so far"
        if (left := self.left(now)) is not None:
            return f"{said}, about {duration(left)} left for all runs"
        of_phase = self._left_of_phase(present, now)
        return said if of_phase is None else f"{said}, about {duration(of_phase)} left of this phase"

    def phase_left(self, now: float) -> str:
        """How long the phase of the first of the present runs will take, in words; empty where nobody knows."""
        present = min(list(self._present.items()), default=(None, None))[1]
        left = self._left_of_phase(present, now) if present else None
        return "" if left is None else f"about {duration(left)} left"

    def _of_timed_phase(self, present: _Present, steps: int, now: float) -> float | None:
        # by the pace of the warm-up, whose first step may have compiled: the phase takes no longer
        if present.phase != "warmup" or present.of < 1:
            return None
        return (now - present.since) / present.of * steps

    def _left_of_phase(self, present: _Present, now: float) -> float | None:
        elapsed = now - present.since
        if 0 < present.done < present.of:
            return elapsed / present.done * (present.of - present.done)
        if present.expected is not None and elapsed < present.expected:
            return present.expected - elapsed
        return None
