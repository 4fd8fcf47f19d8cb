"""Rows of arrays on a Warp device, copied to the host while the device goes on.

A slot has arrays on the device and, for a GPU, their copies in pinned host memory. Copies run on a stream of their own
as soon as the work before them is done. On the CPU the device's arrays are the host's.
"""

from __future__ import annotations

from collections.abc import Mapping
from queue import SimpleQueue
from typing import Any

from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import RING_BLOCKS, Captured


class Slot:
    """Arrays [row, ...] by name, on the device and on the host.

    first  number of its first row among those of all slots
    """

    def __init__(
        self, device: Any, copying: Any, first: int, arrays: Mapping[str, Any], host: Mapping[str, Any]
    ) -> None:
        """arrays   on the device, and
        host     on the host: the same ones on the CPU
        copying  the stream that copies; None on the CPU
        """
        self.first = first
        self.arrays = arrays
        self._device = device
        self._copying = copying
        self._copied: Any = None
        self._host = host

    def begin_copy(self, rows: int) -> None:
        """Enqueue the copy of the first rows behind what the device has been given to do."""
        if self._copying is None:
            return
        import warp as wp

        self._copying.wait_event(self._device.stream.record_event())
        for name, array in self.arrays.items():
            wp.copy(self._host[name], array, count=rows * (array.size // array.shape[0]), stream=self._copying)
        self._copied = self._copying.record_event(self._copied)

    def wait(self) -> None:
        """Return when the copy is there."""
        if self._copied is not None:
            import warp as wp

            wp.synchronize_event(self._copied)

    def host(self, name: str, rows: int) -> NDArray[Any]:
        """The first rows of an array on the host: not a copy."""
        array: NDArray[Any] = self._host[name].numpy()[:rows]
        return array


class Slots:
    """A few slots alike. The thread that steps takes one; any thread gives it back.

    rows    of a slot
    arrays  on the device, by name: the rows of all slots one after the other, so that one CUDA graph can fill any slot
    """

    def __init__(self, device: Any, shapes: Mapping[str, tuple[tuple[int, ...], Any]]) -> None:
        """shapes  of a slot's arrays, and Warp's dtype, by name; the first dimension is the row"""
        import warp as wp

        rows = self.rows = next(iter(shapes.values()))[0][0]

        def allocated(**where: Any) -> dict[str, Any]:
            return {
                name: wp.empty((RING_BLOCKS * rows, *shape[1:]), dtype=dtype, **where)
                for name, (shape, dtype) in shapes.items()
            }

        self.arrays = allocated(device=device)
        copying = wp.Stream(device) if device.is_cuda else None
        host = self.arrays if copying is None else allocated(device="cpu", pinned=True)

        def of_rows(first: int) -> Slot:
            parts = ({name: a[first : first + rows] for name, a in arrays.items()} for arrays in (self.arrays, host))
            return Slot(device, copying, first, *parts)

        self.all = tuple(of_rows(number * rows) for number in range(RING_BLOCKS))
        self._free: SimpleQueue[Slot] = SimpleQueue()
        for slot in self.all:
            self._free.put(slot)

    def take(self) -> Slot:
        """A slot that nobody uses; at most RING_BLOCKS may be taken."""
        return self._free.get_nowait()

    def give_back(self, slot: Slot) -> None:
        """The slot may be taken again."""
        self._free.put(slot)


class SlotBlock(Captured):
    """Steps in the first rows of a slot, which goes back to its kind when they were read."""

    def __init__(self, slots: Slots, slot: Slot, rows: int) -> None:
        self._slots = slots
        self._slot = slot
        self._rows = rows

    def host(self, name: str) -> NDArray[Any]:
        """The steps of an array on the host: not a copy."""
        return self._slot.host(name, self._rows)

    def wait(self) -> None:
        """See Captured.wait."""
        self._slot.wait()

    def release(self) -> None:
        """See Captured.release."""
        self._slots.give_back(self._slot)
