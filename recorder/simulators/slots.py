"""Rows of arrays on a device, copied to the host while the device goes on, whatever library the arrays are of.

A slot has arrays on the device and, for a GPU, their copies in pinned host memory. Copies run on a stream of their own
as soon as the work before them is done. On the CPU the device's arrays are the host's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.captured import RING_BLOCKS, Captured, States, gathered
from gpusimbench.recorder.simulators.evidence import Evidence

Shapes = Mapping[str, tuple[tuple[int, ...], Any]]
"""Shape and the library's dtype by name; the first dimension is the row."""

Host = Callable[[str], NDArray[Any]]
"""The steps of a slot's array on the host [step, ...], by name: not a copy."""


@dataclass(eq=False)
class Slot:
    """Arrays [row, ...] by name, on the device and on the host.

    first   number of its first row among those of all slots
    arrays  on the device
    host    the copies; the same arrays on the CPU
    copied  the event behind the last copy; None where there was none
    """

    first: int
    arrays: Mapping[str, Any]
    host: Mapping[str, Any]
    copied: Any = None


class Slots(ABC):
    """A few slots alike, of one library's arrays. The thread that steps takes a slot; any thread gives it back.

    rows    of a slot
    all     the slots
    arrays  on the device, by name: the rows of all slots one after the other, so that one CUDA graph can fill any slot
    """

    def __init__(self, shapes: Shapes, *, pinned: bool) -> None:
        """shapes  of a slot's arrays
        pinned  whether the host has copies; False on the CPU
        """
        self._pinned = pinned
        rows = self.rows = next(iter(shapes.values()))[0][0]
        whole = {name: ((RING_BLOCKS * rows, *shape[1:]), dtype) for name, (shape, dtype) in shapes.items()}
        self.arrays = {name: self._allocated(*made, pinned=False) for name, made in whole.items()}
        host = {name: self._allocated(*made, pinned=True) for name, made in whole.items()} if pinned else self.arrays

        def slot_at(first: int) -> Slot:
            parts = ({name: a[first : first + rows] for name, a in arrays.items()} for arrays in (self.arrays, host))
            return Slot(first, *parts)

        self.all = tuple(slot_at(number * rows) for number in range(RING_BLOCKS))
        self._free: SimpleQueue[Slot] = SimpleQueue()
        for slot in self.all:
            self._free.put(slot)

    @abstractmethod
    def _allocated(self, shape: tuple[int, ...], dtype: Any, *, pinned: bool) -> Any:
        """An array on the device, or in pinned memory of the host."""

    @abstractmethod
    def _copy(self, slot: Slot, rows: int) -> Any:
        """Enqueue the copy of the first rows, on a stream of its own; returns the event behind it."""

    @abstractmethod
    def _wait_for(self, event: Any) -> None:
        """Return when an event has happened."""

    def begin_copy(self, slot: Slot, rows: int) -> None:
        """Enqueue the copy of the first rows of a slot behind what the device has been given to do."""
        if self._pinned:
            slot.copied = self._copy(slot, rows)

    def wait(self, slot: Slot) -> None:
        """Return when the last copy of a slot is there."""
        if slot.copied is not None:
            self._wait_for(slot.copied)

    def take(self) -> Slot:
        """A slot that nobody uses; at most RING_BLOCKS may be taken."""
        return self._free.get_nowait()

    def give_back(self, slot: Slot) -> None:
        """The slot may be taken again."""
        self._free.put(slot)


class SlotBlock(Captured):
    """Steps in the first rows of a slot, which goes back to its kind when they were read."""

    def __init__(
        self,
        slots: Slots,
        slot: Slot,
        rows: int,
        *,
        split: Callable[[Host, slice], States],
        told: Callable[[Host], Evidence | None],
        held: str = "",
    ) -> None:
        """split  makes states of the slot's arrays, for a range of environments
        told   makes evidence of them
        held   name of the array of actions that the engine held, where the slot has it
        """
        self._slots = slots
        self._slot = slot
        self._rows = rows
        self._split = split
        self._told = told
        self._held = held

    def _host(self, name: str) -> NDArray[Any]:
        array: NDArray[Any] = self._slot.host[name].numpy()[: self._rows]
        return array

    def wait(self) -> None:
        """See Captured.wait."""
        self._slots.wait(self._slot)

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        return self._split(self._host, envs)

    def actions(self, envs: slice) -> NDArray[np.float32] | None:
        """See Captured.actions."""
        return self._host(self._held)[:, envs] if self._held in self._slot.arrays else None

    def evidence(self) -> Evidence | None:
        """See Captured.evidence."""
        return self._told(self._host)

    def release(self) -> None:
        """See Captured.release."""
        self._slots.give_back(self._slot)


class Slotted(Simulator):
    """An adapter that has slots once ``reserve`` was called; of longer blocks than a slot holds, it makes parts."""

    _slots: Slots | None = None
    _counted: Evidence | None = None
    """Of the last call of ``states``; None where the adapter has to ask its engine."""

    @abstractmethod
    def _fill(self, slots: Slots, slot: Slot, n_step: int) -> Captured:
        """Make these steps, store them in the first rows of the slot, and begin to copy it."""

    def begin_states(self, n_step: int) -> Captured:
        """See Simulator.begin_states."""
        self.reserve(n_step)
        assert self._slots is not None
        if n_step > self._slots.rows:
            return super().begin_states(n_step)
        return self._fill(self._slots, self._slots.take(), n_step)

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        self.reserve(n_step)
        assert self._slots is not None
        states, self._counted = gathered(self.begin_states, n_step, self._slots.rows)
        return states
