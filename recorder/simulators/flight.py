"""The last steps of all environments, held while the engine goes on, and the first failure of each of them.

At the first failure of an environment, a flight still has the steps before it. What an engine cannot do on its device
is done here with what every adapter has: blocks of captured states.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import Captured, Held, States
from gpusimbench.schemas.fields import StateField

BEFORE = 100
"""Steps before the step of the failure that are kept."""

AFTER = 10
"""Steps after it that are kept."""

BLOCK_STEPS = 20
"""Steps between two looks at what failed; more than AFTER."""

RING_STEPS = BEFORE + AFTER + 2 * BLOCK_STEPS
"""Steps that are held: a window may reach back from the block that was looked at last, and another is being made."""


class FailureKind(IntEnum):
    """What first happened to an environment; where several things happen in one step, the first of these is told."""

    NOT_FINITE = 0
    OVERFLOW = 1
    OUT_OF_BOUNDS = 2


NEVER = int(np.iinfo(np.int64).max)
"""In place of a failure, for an environment that has not failed."""


@dataclass(frozen=True)
class Watch:
    """What is looked for.

    fields   layout of the states
    within   a body further than this from the origin of its environment, along any axis, is out of bounds [m]; None:
             nothing is
    origins  of the environments [env, 3] [m]; None where positions are relative to them, or all are zero
    fatal    overflow bits that say that something was dropped
    """

    fields: tuple[StateField, ...]
    within: float | None = None
    origins: NDArray[np.float64] | None = None
    fatal: int = 0

    def local(self, field: StateField, array: NDArray[np.floating], envs: slice = slice(None)) -> NDArray[np.floating]:
        """Positions [..., env, item, 3] relative to the origins of these environments; no copy where they are so."""
        if self.origins is None or field.frame != "world":
            return array
        return np.asarray(array.astype(np.float64) - self.origins[envs, np.newaxis, : array.shape[-1]])

    def beyond(self, field: StateField, array: NDArray[np.floating], envs: slice = slice(None)) -> NDArray[np.bool_]:
        """Numbers of a field [..., env, item, width] that are out of bounds, in the same shape."""
        if self.within is None or field.field != "position":
            return np.zeros(array.shape, dtype=bool)
        return np.asarray(np.abs(self.local(field, array, envs)) > self.within)


def failure(step: int, kind: FailureKind) -> int:
    """A failure as one number: the earlier it is, and the earlier its kind, the smaller."""
    return step * len(FailureKind) + kind


def step_and_kind(failure: int) -> tuple[int, FailureKind]:
    """Step and kind of a failure."""
    return failure // len(FailureKind), FailureKind(failure % len(FailureKind))


class Flight(ABC):
    """Steps all environments, holds the last RING_STEPS states of each, and tells which failed.

    The recorder calls ``failures`` once for the initial state, then ``begin`` and ``failures`` in turns: at most
    `ahead` blocks are begun and not asked for. Windows are asked for after ``failures``, of steps at most
    BEFORE + AFTER + BLOCK_STEPS behind the last one looked at.

    ahead       blocks that may be begun before the first of them is asked for; at most 2
    held_bytes  memory that the states take
    where       where they are held: "device" or "host"
    """

    ahead: int
    held_bytes: int
    where: str

    @abstractmethod
    def begin(self, n_step: int) -> None:
        """Begin the next steps, at most BLOCK_STEPS; return before the device is done, if it can."""

    @abstractmethod
    def failures(self) -> NDArray[np.int64]:
        """Wait for the next block; the first failure of each environment so far, [env], as ``failure`` or NEVER."""

    @abstractmethod
    def window(self, env: int, first: int, last: int) -> States:
        """States of an environment after steps `first` to `last`: one array [step, 1, item, width] per field."""

    @abstractmethod
    def overflow(self, env: int, step: int) -> int:
        """Overflow bits of an environment in a step that is still held."""


class Steps(Protocol):
    """What HostFlight needs of a simulator; as of base.Simulator."""

    n_env: int
    blocks_ahead: ClassVar[int]

    def state(self) -> States:
        """See Simulator.state."""

    def reserve(self, n_step: int) -> None:
        """See Simulator.reserve."""

    def begin_states(self, n_step: int) -> Captured:
        """See Simulator.begin_states."""


class HostFlight(Flight):
    """The same for every simulator: its captured states are copied to a ring in the host's memory, and looked at."""

    where = "host"

    def __init__(self, simulator: Steps, watch: Watch) -> None:
        simulator.reserve(BLOCK_STEPS)
        self._simulator = simulator
        self._watch = watch
        self.ahead = min(2, simulator.blocks_ahead)
        n_env = simulator.n_env
        shapes = [(RING_STEPS, n_env, len(field.items), field.width) for field in watch.fields]
        self._ring = [np.zeros(shape, dtype=f.dtype) for shape, f in zip(shapes, watch.fields, strict=True)]
        self._bits = np.zeros((RING_STEPS, n_env), dtype=np.uint32)
        self.held_bytes = sum(array.nbytes for array in (*self._ring, self._bits))
        self._failures = np.full(n_env, NEVER, dtype=np.int64)
        self._looked_at = 0  # rows so far
        first = Held(tuple(array[np.newaxis].copy() for array in simulator.state()))
        self._begun: deque[Captured] = deque([first])

    def begin(self, n_step: int) -> None:
        """See Flight.begin."""
        self._begun.append(self._simulator.begin_states(n_step))

    def failures(self) -> NDArray[np.int64]:
        """See Flight.failures."""
        block = self._begun.popleft()
        block.wait()
        try:
            states, evidence = block.states(slice(None)), block.evidence()
            rows = np.arange(self._looked_at, self._looked_at + len(states[0]))
            bits = evidence.overflow if evidence is not None else None
            for ring, array in zip(self._ring, states, strict=True):
                ring[rows % RING_STEPS] = array
            self._bits[rows % RING_STEPS] = 0 if bits is None else bits
            for kind, failed in self._failed(states, bits):
                there = failed.any(axis=0)
                when = rows[0] + failed.argmax(axis=0)
                self._failures[there] = np.minimum(self._failures, when * len(FailureKind) + kind)[there]
        finally:
            block.release()
        self._looked_at += len(rows)
        return self._failures

    def _failed(
        self, states: States, bits: NDArray[np.uint32] | None
    ) -> Iterator[tuple[FailureKind, NDArray[np.bool_]]]:
        # what happened anywhere in the block, and where [step, env]
        for field, array in zip(self._watch.fields, states, strict=True):
            for kind, wrong in (
                (FailureKind.NOT_FINITE, ~np.isfinite(array)),
                (FailureKind.OUT_OF_BOUNDS, self._watch.beyond(field, array)),
            ):
                if wrong.any():
                    yield kind, np.asarray(wrong.any(axis=(2, 3)))
        if bits is not None and self._watch.fatal and (hit := bits & np.uint32(self._watch.fatal)).any():
            yield FailureKind.OVERFLOW, hit != 0

    def window(self, env: int, first: int, last: int) -> States:
        """See Flight.window."""
        return tuple(ring[_rows(first, last), env : env + 1] for ring in self._ring)

    def overflow(self, env: int, step: int) -> int:
        """See Flight.overflow."""
        return int(self._bits[step % RING_STEPS, env])


def _rows(first: int, last: int) -> Sequence[int]:
    # of the ring
    return [step % RING_STEPS for step in range(first, last + 1)]
