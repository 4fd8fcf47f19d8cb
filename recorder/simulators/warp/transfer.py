"""Slots of Warp's arrays, and the evidence in MuJoCo Warp's counts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.evidence import CONSTRAINT_ROWS, CONTACTS, SOLVER_ITERATIONS, Evidence
from gpusimbench.recorder.simulators.slots import Shapes, Slot, Slots


class WarpSlot(Slot):
    """A slot on a Warp device."""

    def __init__(
        self, first: int, arrays: Mapping[str, Any], host: Mapping[str, Any], device: Any, copying: Any
    ) -> None:
        """copying  the stream that copies; None on the CPU"""
        super().__init__(first, arrays, host)
        self._device = device
        self._copying = copying
        self._copied: Any = None

    def begin_copy(self, rows: int) -> None:
        """See Slot.begin_copy."""
        if self._copying is None:
            return
        import warp as wp

        self._copying.wait_event(self._device.stream.record_event())
        for name, array in self.arrays.items():
            wp.copy(self._host[name], array, count=rows * (array.size // array.shape[0]), stream=self._copying)
        self._copied = self._copying.record_event(self._copied)

    def wait(self) -> None:
        """See Slot.wait."""
        if self._copied is not None:
            import warp as wp

            wp.synchronize_event(self._copied)


class WarpSlots(Slots):
    """Slots on a Warp device."""

    def __init__(self, device: Any, shapes: Shapes) -> None:
        """shapes  with Warp's dtypes"""
        import warp as wp

        self._device = device
        self._copying = wp.Stream(device) if device.is_cuda else None
        super().__init__(shapes, pinned=device.is_cuda)

    def _allocated(self, shape: tuple[int, ...], dtype: Any, *, pinned: bool) -> Any:
        import warp as wp

        return wp.empty(shape, dtype=dtype, device="cpu" if pinned else self._device, pinned=pinned)

    def _slot(self, first: int, arrays: Mapping[str, Any], host: Mapping[str, Any]) -> WarpSlot:
        return WarpSlot(first, arrays, host, self._device, self._copying)


def evidence_of(counts: NDArray[np.int32]) -> Evidence:
    """From counts [step, kind, env]: contacts, constraint rows, iterations, overflow bits."""
    return Evidence(
        {CONTACTS.name: counts[:, 0], CONSTRAINT_ROWS.name: counts[:, 1], SOLVER_ITERATIONS.name: counts[:, 2]},
        overflow=counts[:, 3].astype(np.uint32),
    )
