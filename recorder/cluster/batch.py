"""The runs of one point of a sweep, or of a set, while several seats make them."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from queue import SimpleQueue
from typing import NamedTuple

from gpusimbench.recorder.process.launch import Result
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode
from gpusimbench.schemas.text import plural

TRIES = 3
"""How often a run is begun at most, where the nodes that make it die."""


class PhaseReport(NamedTuple):
    """A run reported how far it is."""

    run: RunConfiguration
    phase: str
    done: int
    of: int


class Ended(NamedTuple):
    """A run ended, so many seconds after it was begun."""

    run: RunConfiguration
    result: Result
    seconds: float


class Said(NamedTuple):
    """Something for the user to know."""

    text: str


class Batch:
    """Which runs are to be made still, and what has happened; for several threads.

    news  of runs, in the order in which they happened
    """

    def __init__(self, runs: Sequence[RunConfiguration]) -> None:
        self.news: SimpleQueue[PhaseReport | Ended | Said] = SimpleQueue()
        self._waiting = deque(runs)
        self._open = list(runs)  # those that have not ended
        self._first = runs[0]
        self._tries = dict.fromkeys((run.run_index for run in runs), 0)
        self._decided = False  # whether others than the first are wanted
        self._stopped = False
        self._changed = threading.Condition()

    def take(self) -> RunConfiguration | None:
        """A run to be made; None when there will be none. Waits while one that is being made may come back."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or not self._open or self._stopped)
            if not self._waiting:
                return None
            run = self._waiting.popleft()
            self._tries[run.run_index] += 1
            return run

    def wait_turn(self, run: RunConfiguration) -> bool:
        """Wait until it is known whether this run is wanted, as the first shows, and tell."""
        with self._changed:
            self._changed.wait_for(lambda: self._decided or self._stopped or run == self._first)
            return not self._stopped

    def decide(self) -> None:
        """The runs behind the first are wanted, too."""
        with self._changed:
            self._decided = True
            self._changed.notify_all()

    def begin_no_more(self) -> None:
        """Runs that are not begun are not made."""
        with self._changed:
            self._open = [run for run in self._open if run not in self._waiting]
            self._waiting.clear()
            self._decided = True
            self._changed.notify_all()

    def stop(self) -> None:
        """No run that has not ended is wanted any more."""
        self.begin_no_more()
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    @property
    def stopped(self) -> bool:
        """Whether stop was called."""
        return self._stopped

    def end(self, run: RunConfiguration, result: Result, seconds: float) -> None:
        """The run has ended."""
        with self._changed:
            self.news.put(Ended(run, result, seconds))  # first, so that nobody finds that all is over and no news of it
            self._open.remove(run)
            self._changed.notify_all()

    def lose(self, run: RunConfiguration, why: str, *, again: bool, seconds: float) -> None:
        """Where the run was made is lost: it is to be made elsewhere, unless that happened too often."""
        with self._changed:
            tries = self._tries[run.run_index]
            if again and tries < TRIES and not self._stopped:
                self._waiting.appendleft(run)
                if run == self._first:
                    self._decided = True  # whoever waits for it may be the only one left to make it
                self._changed.notify_all()
                self.news.put(Said(f"{plural(run.n_env, 'env')}: run {run.run_index + 1} is begun again: {why}"))
                return
        self.end(run, lost(run, f"lost {tries} times, with the node that made it: {why}"), seconds)

    def give_up(self, why: str) -> None:
        """Nobody is left to make the runs that have not ended."""
        with self._changed:
            self._waiting.clear()
            for run in list(self._open):
                self.end(run, lost(run, why), 0.0)

    @property
    def over(self) -> bool:
        """Whether every run has ended, or is not to be made."""
        return not self._open


def lost(run: RunConfiguration, why: str) -> Result:
    """The result of a run of which there is nothing."""
    return Result(run.run_index, "incomplete", why, None, ExitCode.DATA_LOST)
