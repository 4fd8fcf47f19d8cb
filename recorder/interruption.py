"""Interruptions that never fall into the middle of a write, an import or the start of a process.

Python delivers a signal between any two instructions, also inside a buffered write, where an exception would lose or
double bytes. While shielded, an interruption is remembered and raised at the end. Only the first one is raised: what
it sets off, bringing a run to its end, is not interrupted in turn.

A time limit (expire_after) is one more interruption. It is raised as KeyboardInterrupt as well, since engines catch
Exception in many places; struck tells the two apart. Code that is interrupted may make another exception of it, such as
an ImportError, or none: struck is the only word on whether there was an interruption, and check raises it again.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)

ENDING = "ending"
"""What a run reports as its phase once nothing interrupts it: the engine is closed, the recording gets its end."""

MARK = "interrupted"
"""An empty file in a run's folder once the user has interrupted: an engine may keep signals from the run."""

_depth = 0
_pending = 0  # number of the signal that waits, and of the one that was raised; 0: none
_raised = 0
_expires = float("inf")  # time.monotonic() at which the time is over


def install(*, also_ignored: bool = False) -> None:
    """Let the first SIGINT or SIGTERM raise KeyboardInterrupt in the main thread, but for shielded code.

    One that was held back since the process began (see blocked) is raised here.

    also_ignored  take over signals that this process was started to ignore, as a shell does for background jobs
    """
    global _pending, _raised, _expires
    _pending = _raised = 0
    _expires = float("inf")
    for number in SIGNALS:
        if also_ignored or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _handle)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def expire_after(seconds: float) -> None:
    """Interrupt once so many seconds from now have passed; 0: never. Comes after install."""
    global _expires
    _expires = time.monotonic() + seconds if seconds else float("inf")
    signal.signal(signal.SIGALRM, _handle)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    signal.setitimer(signal.ITIMER_REAL, seconds)


def struck() -> str:
    """What interrupted since install, the first counts: "INTERRUPTED", "TIMEOUT" (that of expire_after), or empty.

    Also true of an interruption that still waits (see shielded), and of a time limit that has passed while an engine's
    own handler, or native code, kept its signal from coming.
    """
    number = _raised or _pending
    if number == signal.SIGALRM or (not number and time.monotonic() >= _expires):
        return "TIMEOUT"
    return "INTERRUPTED" if number else ""


def check() -> None:
    """Raise the interruption again that was raised before, where what it met has swallowed it."""
    if _raised:
        raise KeyboardInterrupt


@contextmanager
def shielded() -> Iterator[None]:
    """Hold interruptions back until the block is left; an error that leaves it goes first.

    Python handles signals in the main thread alone: in another one there is nothing to hold back.
    """
    global _depth
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _depth += 1
    try:
        yield
    finally:
        _depth -= 1
    if _pending and not _depth:
        _raise(_pending)


@contextmanager
def postponed() -> Iterator[None]:
    """As shielded, in a program that has handlers of its own: they are called when the block is left."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[tuple[int, FrameType | None]] = []
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, handler in before.items():
        if callable(handler):
            signal.signal(number, lambda caught, frame: waiting.append((caught, frame)))
    try:
        yield
    finally:
        for number, handler in before.items():
            if callable(handler):
                signal.signal(number, handler)
    for caught, frame in waiting:
        handler = before[signal.Signals(caught)]
        if callable(handler):
            handler(caught, frame)


@contextmanager
def blocked() -> Iterator[None]:
    """As shielded, and processes started meanwhile get no signal either until they call install."""
    with shielded():  # a signal may still reach another thread, and Python then handles it in this one
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore() -> None:
    """From here on nothing interrupts: the run is being brought to its end."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number in (*SIGNALS, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)


def _handle(number: int, frame: object) -> None:
    global _pending
    if _raised:
        return
    if _depth:
        _pending = _pending or number
    else:
        _raise(number)


def _raise(number: int) -> None:
    global _pending, _raised
    _pending, _raised = 0, number
    raise KeyboardInterrupt
