"""How long is waited for a file elsewhere, whoever has it and whatever it is asked for."""

from __future__ import annotations

import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import TypeVar

_T = TypeVar("_T")


class TooSlow(Exception):
    """What was asked for did not come in time; the message says what was waited for."""


class Patience:
    """The time that is left for one file. Only waiting counts, and requests at the same time count once.

    answer_s  for one request, besides what its bytes may take [s]
    file_s    for all requests together, besides what their bytes may take [s]
    rate      at which bytes have to come at least [byte/s]
    """

    def __init__(self, answer_s: float, file_s: float, rate: float) -> None:
        self._answer_s, self._file_s, self._rate = answer_s, file_s, rate
        self._lock = Lock()
        self._waiting = 0  # requests
        self._since = 0.0  # when the first of them began
        self._waited = 0.0  # before
        self._bytes = 0
        self._over = ""

    def limit(self, size: int) -> float:
        """For how long a request of so many bytes is waited for from now on [s]."""
        with self._lock:
            now = time.monotonic() - self._since if self._waiting else 0.0
            left = self._file_s + self._bytes / self._rate - self._waited - now
            return max(0.0, min(self._answer_s + size / self._rate, left))

    def call(self, request: Callable[[], _T], size: int) -> _T:
        """What a request of `size` bytes returns or raises. TooSlow where that takes too long, and from then on.

        A request that cannot be ended is left alone, in a thread that does not keep the process alive.
        """
        limit = self.limit(size)
        if self._over or not limit:
            raise TooSlow(self._over or self._slow())
        outcome: SimpleQueue[tuple[list[_T], BaseException | None]] = SimpleQueue()

        def ask() -> None:
            try:
                outcome.put(([request()], None))
            except BaseException as error:
                outcome.put(([], error))

        self._begin()
        try:
            Thread(target=ask, daemon=True).start()
            found, error = outcome.get(timeout=limit)
        except Empty:
            whole = limit >= self._answer_s + size / self._rate
            self._over = f"no answer within {limit:.3g} s" if whole else self._slow()
            raise TooSlow(self._over) from None
        finally:
            self._end()
        if error is not None:
            raise error
        with self._lock:
            self._bytes += size
        return found[0]

    def _begin(self) -> None:
        with self._lock:
            if not self._waiting:
                self._since = time.monotonic()
            self._waiting += 1

    def _end(self) -> None:
        with self._lock:
            self._waiting -= 1
            if not self._waiting:
                self._waited += time.monotonic() - self._since

    def _slow(self) -> str:
        return f"after {self._file_s:.3g} s of waiting, what comes is slower than {self._rate:.0f} bytes a second"
