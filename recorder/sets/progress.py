"""Progress of a set of runs on stderr: a bar on a terminal, one line a run elsewhere."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from gpusimbench.recorder.process.launch import Result
from gpusimbench.recorder.run.pace import Pace
from gpusimbench.schemas.commands.output import show_path
from gpusimbench.schemas.commands.progress import Ticker, duration, is_terminal
from gpusimbench.schemas.text import line, show


class SetProgress(Protocol):
    """What the command shows while it works; a context manager."""

    def __enter__(self) -> SetProgress: ...

    def __exit__(self, *details: object) -> None: ...

    def update(self, run: int, phase: str, done: int, of: int) -> None:
        """`done` of `of` steps of a phase of a run (from 0) are done."""

    def finish(self, result: Result, elapsed: float | None = None) -> None:
        """A run ended, so many seconds after it began; None: it began when the one before had ended."""

    def path(self, path: Path) -> None:
        """Print the path of a run's file on standard output."""


def make_progress(title: str, runs: int, done: int = 0) -> SetProgress:
    """A bar where stderr is a terminal, lines otherwise; `done` of the runs are there already."""
    return BarProgress(title, runs, done) if is_terminal(sys.stderr) else LineProgress(title, runs, done)


def say(text: str) -> None:
    """One line on stderr, between sets of runs."""
    show(line(text), error=True)


def describe(result: Result, runs: int, elapsed: float) -> str:
    """One line on how a run ended."""
    line = f"run {result.run_index + 1}/{runs} {result.status} in {elapsed:.1f} s"
    return line if result.status == "complete" else f"{line}: {result.reason}"


class LineProgress:
    """A line for the set, one for each run's end, and between them, seldom, how far the present run is."""

    def __init__(self, title: str, runs: int, done: int = 0, clock: Callable[[], float] = time.monotonic) -> None:
        self._title = title
        self._runs = runs
        self._clock = clock
        self._pace = Pace(runs, done, clock())
        self._ticker = Ticker(self._pace.words, live=False, clock=clock)

    def __enter__(self) -> LineProgress:
        say(self._title)
        self._ticker.__enter__()
        return self

    def __exit__(self, *details: object) -> None:
        self._ticker.__exit__(*details)

    def update(self, run: int, phase: str, done: int, of: int) -> None:
        """See SetProgress.update."""
        with self._ticker.paused():
            self._pace.update(run, phase, done, of, self._clock())

    def finish(self, result: Result, elapsed: float | None = None) -> None:
        """See SetProgress.finish."""
        with self._ticker.paused():
            took = self._pace.finish(result.run_index, self._clock(), elapsed)
            say(describe(result, self._runs, took))

    def path(self, path: Path) -> None:
        """See SetProgress.path."""
        show_path(path)


class BarProgress:
    """Two bars: the runs, and the phase of the present one."""

    def __init__(self, title: str, runs: int, done: int) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, ProgressColumn, Task, TextColumn, TimeElapsedColumn
        from rich.progress import Progress as RichProgress
        from rich.text import Text

        class Left(ProgressColumn):  # type: ignore[misc]
            def render(self, task: Task) -> Text:
                return Text(task.fields["left"](time.monotonic()))

        self._bars: Any = RichProgress(
            TextColumn("{task.description:<24}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            Left(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=False,  # what is printed there is for a program, wherever it goes
            redirect_stderr=False,
        )
        self._title = title
        self._runs = runs
        self._done = done
        self._pace = Pace(runs, done, time.monotonic())

    def __enter__(self) -> BarProgress:
        self._bars.start()
        self._bars.console.print(line(self._title), highlight=False, markup=False)
        self._run_bar = self._bars.add_task("runs", total=self._runs, completed=self._done, left=self._left)
        self._phase_bar = self._bars.add_task("starting", total=None, left=self._pace.phase_left)
        return self

    def __exit__(self, *details: object) -> None:
        self._bars.stop()

    def update(self, run: int, phase: str, done: int, of: int) -> None:
        """See SetProgress.update."""
        self._pace.update(run, phase, done, of, time.monotonic())
        self._bars.update(self._phase_bar, description=f"run {run + 1}: {phase}", completed=done, total=of)

    def finish(self, result: Result, elapsed: float | None = None) -> None:
        """See SetProgress.finish."""
        took = self._pace.finish(result.run_index, time.monotonic(), elapsed)
        self._bars.console.print(line(describe(result, self._runs, took)), highlight=False, markup=False)
        self._bars.advance(self._run_bar)

    def _left(self, now: float) -> str:
        left = self._pace.left(now)
        return "" if left is None else f"about {duration(left)} left"

    def path(self, path: Path) -> None:
        """See SetProgress.path; where the bars share the terminal with standard output, unbroken above them."""
        if _one_terminal():
            self._bars.console.print(line(str(path)), soft_wrap=True, markup=False, emoji=False, highlight=False)
        else:
            show_path(path)


def _one_terminal() -> bool:
    try:
        out, err = sys.stdout.fileno(), sys.stderr.fileno()
        return os.isatty(out) and os.isatty(err) and os.fstat(out).st_rdev == os.fstat(err).st_rdev
    except (AttributeError, OSError):  # a standard stream that is closed
        return False
