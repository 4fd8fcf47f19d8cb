"""Blocks of captured steps: the engine steps, a thread of its own writes what it did while it steps on, and the clock
says what that cost.

Blocks of steps go round in a ring of RING_BLOCKS: some are being made, one is on its way to the host, some are being
written. Nothing is ever dropped. Where writing is slower than the engine, the engine stands still until a block of the
ring is free again, and for how long is recorded.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture import workers
from gpusimbench.recorder.capture.actions import Actions
from gpusimbench.recorder.interruption import shielded
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.captured import RING_BLOCKS, Captured, Held


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


class CaptureClock:
    """When blocks had arrived at the host, and how long the engine stood still before each was begun.

    All readings are of the host's monotonic clock [ns], arrays [2, block]: begins and ends.

    blocks  each begins where the one before it ends; the last may have fewer steps
    stalls  waits for the writer with nothing left for the engine to do
    drain   from the last block's arrival until all was written
    """

    def __init__(self) -> None:
        self._arrived = [time.perf_counter_ns()]
        self._stalls: list[tuple[int, int]] = []
        self._written = self._arrived[0]

    def arrive(self) -> None:
        """A block has arrived."""
        self._arrived.append(time.perf_counter_ns())

    def stall(self, wait: Callable[[], None]) -> None:
        """Wait, and keep how long."""
        begin = time.perf_counter_ns()
        wait()
        self._stalls.append((begin, time.perf_counter_ns()))

    def written(self) -> None:
        """Everything has been written."""
        self._written = time.perf_counter_ns()

    @property
    def drain(self) -> NDArray[np.int64]:
        """See the class."""
        return np.array([[self._arrived[-1]], [self._written]], dtype=np.int64)

    @property
    def blocks(self) -> NDArray[np.int64]:
        """See the class."""
        return np.array([self._arrived[:-1], self._arrived[1:]], dtype=np.int64)

    @property
    def stalls(self) -> NDArray[np.int64]:
        """See the class."""
        return np.array(self._stalls, dtype=np.int64).reshape(-1, 2).T


def step_and_capture(
    simulator: Simulator,
    writing: Writing[Block],
    clock: CaptureClock,
    *,
    first: int,
    last: int,
    block_steps: int,
    prepare: Callable[[int, int], Actions | None],
    progress: Callable[[int], None],
    stopped: Callable[[], bool],
    between: Sequence[tuple[int, Callable[[], None]]] = (),
) -> None:
    """Put the present state, of step `first`, and those of all steps up to `last`, `block_steps` of them a block.

    prepare   hands the engine the actions of the next steps, by the first of them and their number, and returns them
    progress  called with the last step begun so far
    stopped   True once a state was not finite: nothing of use follows
    between   what is called once, with nothing begun ahead of it, after a step from `first` to `last`; in their order
    """
    writing.put(Block(first, Held(tuple(array[np.newaxis].copy() for array in simulator.state())), None))
    ahead: deque[Block] = deque()
    begun, calls = first, deque(between)
    while (begun < last and not stopped()) or ahead or (calls and not stopped()):
        due = bool(calls) and begun == calls[0][0]
        if due and not ahead:
            calls.popleft()[1]()
            continue
        room = len(ahead) < simulator.blocks_ahead and len(ahead) + writing.unwritten < RING_BLOCKS
        if begun < last and not stopped() and not due and (room or not ahead):
            if not room:
                clock.stall(lambda: writing.wait(RING_BLOCKS - 1))
            progress(begun)
            count = min(block_steps, last - begun)
            if calls:
                count = min(count, calls[0][0] - begun)
            actions = prepare(begun, count)
            ahead.append(Block(begun + 1, simulator.begin_states(count), actions))
            begun += count
        else:
            block = ahead.popleft()
            block.captured.wait()
            clock.arrive()
            writing.put(block)
            writing.wait(RING_BLOCKS)  # never waits; an error of the writer is to end the stepping at once
