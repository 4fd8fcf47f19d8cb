"""The capture phase's loop: an engine steps, its states go to whoever writes them, and the clock says what that cost.

Blocks of steps go round in a ring of RING_BLOCKS: some are being made, one is on its way to the host, some are being
written. Nothing is ever dropped. Where writing is slower than the engine, the engine stands still until a block of the
ring is free again, and for how long is recorded.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.capture.actions import Actions
from gpusimbench.recorder.capture.writing import Block, Writing
from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.captured import RING_BLOCKS, Held


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
