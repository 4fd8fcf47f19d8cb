"""Slots of a device and their copies on the host, with NumPy in the place of a device's library."""

from __future__ import annotations

from queue import Empty
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import RING_BLOCKS
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots

ROWS, N_ENV = 4, 3


class Array(np.ndarray):
    """An array of a library, which gives NumPy's when asked for it."""

    def numpy(self) -> NDArray[Any]:
        """Not a copy."""
        return np.asarray(self)


class Library(Slots):
    """Slots of states and actions.

    waited  for which events, in order; an event is the number of a copy
    """

    def __init__(self, *, pinned: bool) -> None:
        self.copies, self.waited = 0, list[int]()
        super().__init__({"x": ((ROWS, N_ENV), np.float32), "ctrl": ((ROWS, N_ENV), np.float32)}, pinned=pinned)

    def _allocated(self, shape: tuple[int, ...], dtype: Any, *, pinned: bool) -> Any:
        return np.zeros(shape, dtype).view(Array)

    def _copy(self, slot: Slot, rows: int) -> int:
        for name, array in slot.arrays.items():
            slot.host[name][:rows] = array[:rows]
        self.copies += 1
        return self.copies

    def _wait_for(self, event: Any) -> None:
        self.waited.append(event)


def block_of(slots: Slots, slot: Slot, rows: int, held: str = "") -> SlotBlock:
    """Steps in the first rows of a slot."""
    return SlotBlock(
        slots, slot, rows, split=lambda host, envs: (host("x")[:, envs],), told=lambda host: Evidence({}), held=held
    )


def test_a_block_holds_what_was_copied() -> None:
    """The device goes on in the same rows while the host reads those before; the last copy is waited for."""
    slots = Library(pinned=True)
    slot = slots.take()
    slot.arrays["x"][:] = 1.0
    slots.begin_copy(slot, 3)
    slot.arrays["x"][:] = 2.0
    block = block_of(slots, slot, 3, held="ctrl")
    block.wait()
    (states,) = block.states(slice(1, 3))
    assert states.shape == (3, 2) and (states == 1.0).all()
    assert (slot.host["x"].numpy()[3] == 0.0).all()  # a row that nobody asked for
    actions = block.actions(slice(0, 1))
    assert actions is not None and actions.shape == (3, 1)
    assert block.evidence() == Evidence({})
    slots.begin_copy(slot, 1)
    block_of(slots, slot, 1).wait()
    assert slots.waited == [1, 2]


def test_arrays_of_the_cpu_are_those_of_the_host() -> None:
    """Nothing is copied and nothing is waited for where the device is the host."""
    slots = Library(pinned=False)
    slot = slots.take()
    slots.begin_copy(slot, ROWS)
    slot.arrays["x"][:] = 5.0
    block = block_of(slots, slot, ROWS)
    block.wait()
    assert (block.states(slice(None))[0] == 5.0).all()
    assert block.actions(slice(None)) is None
    assert slots.copies == 0 and slots.waited == []


def test_slots_come_back() -> None:
    """There are as many slots as blocks that the recorder holds, in rows of their own; a released block gives its slot
    back."""
    slots = Library(pinned=True)
    taken = [slots.take() for _ in range(RING_BLOCKS)]
    assert [slot.first for slot in taken] == [number * ROWS for number in range(RING_BLOCKS)]
    taken[1].arrays["x"][:] = 7.0
    assert [(slots.arrays["x"][slot.first : slot.first + ROWS] == 7.0).all() for slot in taken] == [False, True, False]
    with pytest.raises(Empty):
        slots.take()
    block_of(slots, taken[1], 1).release()
    assert slots.take() is taken[1]
