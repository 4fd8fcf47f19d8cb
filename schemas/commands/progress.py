"""How far a command is, on standard error: nothing for two seconds, then a live line on a terminal, lines elsewhere.

A command enters a Progress. Whatever it calls says by `each` or `received` what it works on; without a Progress, as in
a library, these say nothing. A thread draws, so that a part that takes long does not silence the rest.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from gpusimbench.schemas import text
from gpusimbench.schemas.text import line

_T = TypeVar("_T")

FIRST_S = 2.0
"""A command that ends sooner says nothing [s]."""

_DRAWN_S = 0.5  # between two looks
_PAUSES_S = (10.0, 20.0, 30.0)  # between lines where there is no terminal; the last of them from then on


class Stage:
    """One loop of a command: its parts, and how long they take.

    title    what is done
    total    parts; 0 where nobody knows
    weights  of the parts in order, such as bytes; equal ones where there are none
    began    [s]
    """

    def __init__(self, title: str, total: int, began: float, weights: Sequence[float] = ()) -> None:
        self.title = title
        self.total = total
        self.began = began
        self.done = 0
        self._weights = weights if len(weights) == total and sum(weights) > 0 else [1.0] * total
        self._passed = 0.0
        self._inside = 0.0

    def advance(self) -> None:
        """A part is done."""
        self._passed += self._weights[self.done] if self.done < len(self._weights) else 0.0
        self._inside = 0.0
        self.done += 1

    def move(self, weight: float) -> None:
        """So much of the present part is done."""
        self._inside += weight

    def share(self) -> float:
        """The share of the whole work that is done; 0 where nobody knows."""
        weight = self._weights[self.done] if self.done < len(self._weights) else 0.0
        whole = sum(self._weights)
        return (self._passed + min(self._inside, weight)) / whole if whole else 0.0

    def words(self, now: float) -> str:
        """What is done, how much of it, how long it has taken and will take at this pace."""
        elapsed, share = now - self.began, self.share()
        said = self.title + (f": {self.done} of {self.total}" if self.total > 1 else "")
        said += f", {duration(elapsed)} so far"
        return f"{said}, about {duration(elapsed * (1.0 - share) / share)} left" if 0.0 < share < 1.0 else said


class Ticker:
    """Draws words now and then from a thread of its own: live where the stream is a terminal, lines elsewhere.

    A context manager. Nothing is drawn within FIRST_S, nor where the variable GSB_PROGRESS is off.

    words   what there is to say; empty for nothing
    live    a line that is drawn over; None: where the stream is a terminal
    clock   [s]
    """

    def __init__(
        self, words: Callable[[float], str], *, live: bool | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._words = words
        self._stream: Any = sys.stderr
        self._live = is_terminal(self._stream) if live is None else live
        self._clock = clock
        self._due = clock() + FIRST_S
        self._pauses = iter(_PAUSES_S)
        self._pause = 0.0
        self._drawn = False
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._before: Any = None

    def __enter__(self) -> Ticker:
        self._before, text.live = text.live, self.paused()
        if os.environ.get("GSB_PROGRESS") != "off":
            self._thread = threading.Thread(target=self._run, daemon=True)
            try:
                self._thread.start()
            except RuntimeError:  # no memory for its stack: the work matters more
                self._thread = None
        return self

    def __exit__(self, *details: object) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join(_DRAWN_S)
        text.live = self._before
        self.erase()

    def paused(self) -> Any:
        """A context manager, to be entered any number of times, in which nothing is drawn and no drawn line stands."""
        return _Paused(self._lock, self.erase)

    def erase(self) -> None:
        """Take the live line off the terminal."""
        with self._lock:
            if self._drawn:
                self._write("\r\x1b[K")
                self._drawn = False

    def tick(self) -> None:
        """Draw what there is to say, where it is time for it."""
        with self._lock:
            now = self._clock()
            if now < self._due:
                return
            said = self._words(now)
            if self._live:
                if said:
                    self._write(f"\r\x1b[K{line(said)[: _columns() - 1]}")
                    self._drawn = True
                else:
                    self.erase()
            elif said:
                self._write(f"{line(said)}\n")
                self._pause = next(self._pauses, self._pause)
                self._due = now + self._pause

    def _write(self, said: str) -> None:
        with suppress(OSError, ValueError):  # nobody reads it any more: the work goes on
            self._stream.write(said)
            self._stream.flush()

    def _run(self) -> None:
        while not self._stop.wait(_DRAWN_S):
            self.tick()


class _Paused:
    def __init__(self, lock: Any, erase: Callable[[], None]) -> None:
        self._lock = lock
        self._erase = erase

    def __enter__(self) -> None:
        self._lock.acquire()
        self._erase()

    def __exit__(self, *details: object) -> None:
        self._lock.release()


class Progress(Ticker):
    """What a command works on, by stages; of stages within stages, the innermost is shown. A context manager.

    command  its name, with which every line begins
    """

    def __init__(self, command: str, *, live: bool | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(self._line, live=live, clock=clock)
        self._command = command
        self.stages: list[Stage] = []

    def __enter__(self) -> Progress:
        global _present
        super().__enter__()
        self._outer, _present = _present, self
        return self

    def __exit__(self, *details: object) -> None:
        global _present
        _present = self._outer
        super().__exit__(*details)

    @contextmanager
    def stage(self, title: str, total: int = 0, weights: Sequence[float] = ()) -> Iterator[Stage]:
        """See `stage`."""
        made = Stage(title, total, self._clock(), weights)
        self.stages.append(made)
        try:
            yield made
        finally:
            self.stages.remove(made)
            self.erase()

    def _line(self, now: float) -> str:
        stages = self.stages[-1:]
        return f"{self._command}: {stages[0].words(now)}" if stages else ""


_present: Progress | None = None


@contextmanager
def stage(title: str, total: int = 0, weights: Sequence[float] = ()) -> Iterator[Stage]:
    """The present command does this now; what is yielded is told of every part that is done.

    total    parts; 0 where nobody knows
    weights  of the parts in order, such as bytes
    """
    if _present is None:
        yield Stage(title, total, 0.0, weights)
    else:
        with _present.stage(title, total, weights) as made:
            yield made


def each(items: Sequence[_T], title: str, weights: Sequence[float] = ()) -> Iterator[_T]:
    """The items of a loop whose body does the work."""
    with stage(title, len(items), weights) as made:
        for item in items:
            yield item
            made.advance()


def received(results: Iterable[_T], title: str, total: int, weights: Sequence[float] = ()) -> Iterator[_T]:
    """Results of an iterator that does the work."""
    with stage(title, total, weights) as made:
        for result in results:
            made.advance()
            yield result


def moved(weight: float) -> None:
    """So much of the present part of the innermost stage is done."""
    if _present is not None and _present.stages:
        _present.stages[-1].move(weight)


def sizes(places: Iterable[object]) -> list[float]:
    """Bytes of files, as weights; nothing where one of them is elsewhere, or is not there."""
    try:
        return [float(place.stat().st_size) if isinstance(place, Path) else _elsewhere() for place in places]
    except OSError:
        return []


def _elsewhere() -> float:
    raise FileNotFoundError


def duration(seconds: float) -> str:
    """A time as people say it: 12 s, 3 min 20 s, 1 h 05 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, left = divmod(whole, 60)
    return f"{minutes} min {left:02} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"


def is_terminal(stream: Any) -> bool:
    """Whether lines can be drawn over on a stream."""
    with suppress(AttributeError, ValueError):  # closed by whoever started this process
        return bool(stream.isatty()) and os.environ.get("TERM") != "dumb"
    return False


def _columns() -> int:
    with suppress(OSError, AttributeError):
        return os.get_terminal_size(sys.stderr.fileno()).columns or 80
    return 80
