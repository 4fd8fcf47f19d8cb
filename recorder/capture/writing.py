"""Blocks of captured steps, written by a thread of their own while the engine steps on."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from gpusimbench.recorder.capture import workers
from gpusimbench.recorder.capture.actions import Actions
from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.simulators.captured import Captured


@dataclass(frozen=True)
class Block:
    """Consecutive steps.

    first_step  the step whose state is the first row
    actions     that led to these states; None where the scene has none, and for the initial state
    """

    first_step: int
    captured: Captured
    actions: Actions | None

    def release(self) -> None:
        """See Captured.release."""
        self.captured.release()


class Releasable(Protocol):
    """What is written, and then not needed any longer."""

    def release(self) -> None:
        """Its memory may be used again."""


Written = TypeVar("Written", bound=Releasable)


class Writing(Generic[Written]):
    """Writes blocks in the order in which they are put; each is released once it is written.

    write  writes one block, in another thread; an error of it is raised by the next call of ``wait`` or by ``finish``,
           and the blocks behind it are released and not written
    alone  without the help of other threads while it keeps up with what is put, see workers.share
    """

    def __init__(self, write: Callable[[Written], None], *, alone: bool = False) -> None:
        self._write = write
        self._alone = alone
        self._blocks: deque[Written] = deque()
        self._unwritten = 0
        self._ended = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._written = threading.Event()  # the thread has ended, or is about to and writes nothing more
        self._thread = threading.Thread(target=self._work, name="writing", daemon=True)
        self._thread.start()

    @property
    def unwritten(self) -> int:
        """Blocks that were put and are not released yet."""
        return self._unwritten

    def put(self, block: Written) -> None:
        """Have a block written; returns at once."""
        with shielded(), self._changed:  # a lock that an interruption leaves held is never given up
            self._blocks.append(block)
            self._unwritten += 1
            self._changed.notify_all()

    def wait(self, most: int) -> None:
        """Return once at most so many blocks are unwritten."""
        with shielded(), self._changed:
            self._changed.wait_for(lambda: self._unwritten <= most or self._error is not None)
        if self._error is not None:
            raise self._error

    def finish(self) -> None:
        """Return once all that was put is written, and end the thread; whatever interrupts waits until then."""
        with shielded():  # two threads must not write one file
            with self._changed:
                self._ended = True
                self._changed.notify_all()
            struck = self._wait_to_the_end()
        if self._error is not None:
            raise self._error
        if struck is not None:
            raise struck

    def _wait_to_the_end(self) -> BaseException | None:
        # the first error that a handler of signals raised meanwhile; Thread.join takes a thread for ended after one
        struck = None
        while True:
            try:
                self._written.wait()
                return struck
            except BaseException as error:
                struck = struck or error

    def _work(self) -> None:
        try:
            self._write_all()
        finally:
            self._written.set()

    def _write_all(self) -> None:
        while (block := self._next()) is not None:
            try:
                try:
                    if self._error is None:
                        self._write(block)
                finally:
                    block.release()
            except BaseException as error:  # whatever it is, the thread that steps is to know it
                self._error = self._error or error
            finally:
                with self._changed:
                    self._unwritten -= 1
                    self._changed.notify_all()

    def _next(self) -> Written | None:
        with self._changed:
            self._changed.wait_for(lambda: self._blocks or self._ended)
            workers.share(not self._alone or self._ended or len(self._blocks) > 1)
            return self._blocks.popleft() if self._blocks else None
