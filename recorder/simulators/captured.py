"""States of consecutive steps on their way from an engine to a recording."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.evidence import Evidence, joined

RING_BLOCKS = 3
"""Blocks of captured steps that the recorder holds at once: being made, on their way to the host, being written."""

BLOCK_STEPS = 50
"""The most steps of a block."""

BLOCK_BYTES = 128 << 20
"""The most bytes of states of a block, of all environments together; a block has one step at least."""

States = tuple[NDArray[np.floating], ...]
"""One array per state field, in the order of Description.fields."""


class Captured(ABC):
    """A block of steps that an adapter was asked for. The recorder calls ``wait`` in the thread that steps, then, in
    other threads, ``states`` for ranges of environments, several at a time, and ``evidence``; at last ``release``."""

    @abstractmethod
    def wait(self) -> None:
        """Return when the device has made these steps and the host has their states."""

    @abstractmethod
    def states(self, envs: slice) -> States:
        """Arrays [step, env of the range, item, width], unchanged until ``release``."""

    def actions(self, envs: slice) -> NDArray[np.float32] | None:
        """What the engine held in each step, [step, env of the range, action]; None where it does not keep that.

        For adapters that make the actions themselves: the recorder writes what was applied instead of what should be.
        """
        return None

    @abstractmethod
    def evidence(self) -> Evidence | None:
        """What the engine shows of each of these steps, unchanged until ``release``; None where it tells nothing."""

    def release(self) -> None:  # noqa: B027 - what owns its arrays has nothing to give back
        """The arrays are not needed any longer: their memory may be used again."""


class Held(Captured):
    """States that are on the host already, in arrays of their own."""

    def __init__(
        self, states: States, evidence: Evidence | None = None, actions: NDArray[np.float32] | None = None
    ) -> None:
        """states   [step, env, item, width], one array a field
        actions  [step, env, action], where the engine told what it held
        """
        self._states = states
        self._evidence = evidence
        self._actions = actions

    def wait(self) -> None:
        """See Captured.wait."""

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        return tuple(array[:, envs] for array in self._states)

    def actions(self, envs: slice) -> NDArray[np.float32] | None:
        """See Captured.actions."""
        return None if self._actions is None else self._actions[:, envs]

    def evidence(self) -> Evidence | None:
        """See Captured.evidence."""
        return self._evidence


def gathered(begin: Callable[[int], Captured], n_step: int, rows: int) -> tuple[States, Evidence | None]:
    """Steps in blocks of at most `rows`, one after the other: states [step, env, item, width] and evidence as copies.

    begin  what begins a block of some steps
    """
    states: list[States] = []
    evidence: list[Evidence] = []
    for first in range(0, n_step, rows):
        block = begin(min(rows, n_step - first))
        block.wait()
        states.append(tuple(array.copy() for array in block.states(slice(None))))
        if (found := block.evidence()) is not None:
            evidence.append(found.copy())
        block.release()
    return states[0] if len(states) == 1 else tuple(map(np.concatenate, zip(*states, strict=True))), joined(evidence)


def row_index(places: Sequence[int]) -> slice | NDArray[np.int64]:
    """An index that takes these rows of an array: a slice where they follow each other, of which numpy gives a view.

    With a list of rows it copies, and lays the copy out in an order that the writer has to copy once more: of 27 bodies
    in 4,096 environments, 10 ms a step.
    """
    first, end = places[0], places[0] + len(places)
    return slice(first, end) if list(places) == list(range(first, end)) else np.array(places)
