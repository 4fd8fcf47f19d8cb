"""Readings at a fixed rate from a thread of their own, while a run goes on in another."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

_R = TypeVar("_R")


class Reading(NamedTuple):
    """One reading for a recording: its topic, and the fields of its message by name; None where nothing told."""

    topic: str
    fields: dict[str, Any]


class Sampler(ABC, Generic[_R]):
    """Reads its sources every `interval_s` while running, and when told to.

    A reading that fails is counted, and the next is tried: one lost reading neither ends the run nor the sampling.

    what          is read, in a word
    phase         of the run, which readings are noted with; empty between phases
    failures      readings that failed
    last_failure  why the last of them did; empty when there were none
    """

    def __init__(self, what: str, interval_s: float) -> None:
        self._readings: list[_R] = []
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name=f"{what}-sampler", daemon=True)
        self._interval_s = interval_s
        self.what = what
        self.phase = ""
        self.failures = 0
        self.last_failure = ""

    def start(self) -> None:
        """Begin sampling."""
        self._thread.start()

    def stop(self) -> None:
        """End sampling; readings can still be taken."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def read_now(self) -> None:
        """Read every source now."""
        with self._lock:
            self._read()

    def take(self) -> list[_R]:
        """The readings since the last call, in order of time."""
        with self._lock:
            readings, self._readings = self._readings, []
        return readings

    @abstractmethod
    def _read(self) -> None:
        """Append readings of every source to `_readings`; the lock is held."""

    def _loop(self) -> None:
        while not self._stop.wait(self._interval_s):
            self.read_now()

    def _try(self, source: str, read: Callable[[], None]) -> None:
        try:
            read()
        except Exception as error:  # whatever a driver raises: the thread must go on
            self.failures += 1
            self.last_failure = f"{source}: {type(error).__name__}: {' '.join(str(error).split())}"
