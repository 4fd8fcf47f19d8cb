"""Threads that share the work on a block: hashing, checking and copying let go of the interpreter's lock."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import chain
from typing import TypeVar

_MOST = 6  # more of them wait for the interpreter rather than work
_SHARES = 4  # of a thread: each is handed over once, for which both threads take the interpreter several times

_S = TypeVar("_S")
_T = TypeVar("_T")


_here = threading.local()


def share(yes: bool) -> None:
    """Whether the calling thread shares its work from now on, as threads do at first.

    Each thread more that works takes the interpreter for a while whenever a user's thread lets go of it.
    """
    _here.shares = yes


@contextmanager
def alone() -> Iterator[None]:
    """The calling thread shares no work with other threads within the block."""
    share(False)
    try:
        yield
    finally:
        share(True)


class Workers:
    """A few threads, started when they are first needed; or none.

    small  the work is too little to share: the calling thread does it
    """

    def __init__(self, *, small: bool) -> None:
        self._small = small
        self._threads: ThreadPoolExecutor | None = None

    @property
    def alone(self) -> bool:
        """Whether the calling thread does all work itself."""
        return self._small or not getattr(_here, "shares", True)

    def start(self, work: Callable[[_S], _T], items: Sequence[_S]) -> Iterable[_T]:
        """Begin the work on all items; the results in order, each once it is there."""
        if self.alone:
            return [work(item) for item in items]
        count = max(2, min(_MOST, len(os.sched_getaffinity(0)) // 2))
        if self._threads is None:
            self._threads = ThreadPoolExecutor(count, thread_name_prefix="capture")
        size = -(-len(items) // (count * _SHARES)) or 1
        shares = [items[at : at + size] for at in range(0, len(items), size)]
        return chain.from_iterable(self._threads.map(lambda share: [work(item) for item in share], shares))

    def later(self, work: Callable[[_S], _T], items: Sequence[_S]) -> Callable[[], Iterable[_T]]:
        """Have other threads begin the work now, where there are any; what is returned gives the results in order."""
        if self.alone:
            return lambda: [work(item) for item in items]
        begun = self.start(work, items)
        return lambda: begun

    def end(self) -> None:
        """End the threads, once they have done what they are at."""
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
            self._threads = None
