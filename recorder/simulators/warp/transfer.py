"""Slots of Warp's arrays, and the evidence in MuJoCo Warp's counts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.evidence import (
    CONSTRAINT_ROWS,
    CONTACTS,
    MISPLACED_CONTACTS,
    SOLVER_ITERATIONS,
    Evidence,
)
from gpusimbench.recorder.simulators.slots import Shapes, Slot, Slots

COUNTED = 5
"""Kinds of counts of a step: see evidence_of."""


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


def count_misplaced(model: Any, data: Any, row: Any, counts: Any) -> None:
    """Enqueue: add the misplaced contacts of a mujoco_warp.Data to counts[row[0], world], which are zero."""
    import warp as wp

    from gpusimbench.recorder.simulators.warp import kernels

    found = data.contact
    wp.launch(
        kernels.count_misplaced,
        dim=found.worldid.shape[0],
        inputs=[row, data.nacon, found.worldid, found.geom, found.pos, found.dist, data.geom_xpos, model.geom_rbound],
        outputs=[counts],
    )


def evidence_of(counts: NDArray[np.int32]) -> Evidence:
    """From counts [step, kind, env]: contacts, constraint rows, iterations, overflow bits, misplaced contacts."""
    return Evidence(
        {
            CONTACTS.name: counts[:, 0],
            CONSTRAINT_ROWS.name: counts[:, 1],
            SOLVER_ITERATIONS.name: counts[:, 2],
            MISPLACED_CONTACTS.name: counts[:, 4],
        },
        overflow=counts[:, 3].astype(np.uint32),
    )
