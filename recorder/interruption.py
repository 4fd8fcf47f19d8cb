"""Interruptions that never fall into the middle of a write.

Python delivers a signal between any two instructions, also inside a buffered write, where an exception would lose or
double bytes. While shielded, an interruption is remembered and raised at the end.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

_depth = 0
_pending = False


def install() -> None:
    """Let SIGINT and SIGTERM raise KeyboardInterrupt in the main thread, but for shielded code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _handle)


@contextmanager
def shielded() -> Iterator[None]:
    """Hold interruptions back until the block is left."""
    global _depth, _pending
    _depth += 1
    try:
        yield
    finally:
        _depth -= 1
        if _pending and not _depth:
            _pending = False
            raise KeyboardInterrupt


def ignore() -> None:
    """From here on nothing interrupts: the run is being brought to its end."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


def _handle(number: int, frame: object) -> None:
    global _pending
    if _depth:
        _pending = True
    else:
        raise KeyboardInterrupt
