"""Threads that share the work on a block: hashing, checking and copying let go of the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

_MOST = 6  # more of them wait for the interpreter rather than work

_S = TypeVar("_S")
_T = TypeVar("_T")


class Workers:
    """A few threads, started when they are first needed; or none.

    alone  the work is too little to share: the calling thread does it
    """

    def __init__(self, *, alone: bool) -> None:
        self.alone = alone
        self._threads: ThreadPoolExecutor | None = None

    def start(self, work: Callable[[_S], _T], items: Sequence[_S]) -> Iterable[_T]:
        """Begin the work on all items; the results in order, each once it is there."""
        if self.alone:
            return [work(item) for item in items]
        if self._threads is None:
            count = max(2, min(_MOST, len(os.sched_getaffinity(0)) // 2))
            self._threads = ThreadPoolExecutor(count, thread_name_prefix="capture")
        return self._threads.map(work, items)
