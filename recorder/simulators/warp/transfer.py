"""Slots of Warp's arrays, and the evidence in MuJoCo Warp's counts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.evidence import CONSTRAINT_ROWS, CONTACTS, SOLVER_ITERATIONS, Evidence
from gpusimbench.recorder.simulators.slots import Shapes, Slot, Slots


class WarpSlots(Slots):
    """Slots on a Warp device."""

    def __init__(self, device: Any, shapes: Shapes) -> None:
        """shapes  with Warp's dtypes"""
        import warp as wp

        self._device = device
        self._copying: Any = wp.Stream(device) if device.is_cuda else None
        super().__init__(shapes, pinned=device.is_cuda)

    def _allocated(self, shape: tuple[int, ...], dtype: Any, *, pinned: bool) -> Any:
        import warp as wp

        return wp.empty(shape, dtype=dtype, device="cpu" if pinned else self._device, pinned=pinned)

    def _copy(self, slot: Slot, rows: int) -> Any:
        import warp as wp

        self._copying.wait_event(self._device.stream.record_event())
        for name, array in slot.arrays.items():
            wp.copy(slot.host[name], array, count=rows * (array.size // array.shape[0]), stream=self._copying)
        return self._copying.record_event(slot.copied)

    def _wait_for(self, event: Any) -> None:
        import warp as wp

        wp.synchronize_event(event)


def evidence_of(counts: NDArray[np.int32]) -> Evidence:
    """From counts [step, kind, env]: contacts, constraint rows, iterations, overflow bits."""
    return Evidence(
        {CONTACTS.name: counts[:, 0], CONSTRAINT_ROWS.name: counts[:, 1], SOLVER_ITERATIONS.name: counts[:, 2]},
        overflow=counts[:, 3].astype(np.uint32),
    )
