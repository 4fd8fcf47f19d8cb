"""States and counts of steps, kept on the device in rows of torch's tensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.genesis.environments import Environments
from gpusimbench.recorder.simulators.genesis.watch import COUNTERS, Watch
from gpusimbench.recorder.simulators.slots import Host, Shapes, Slot, Slots

_ERRORS = "error_codes"
"""Counts have the names of their counters, states those that environments give them."""


class Rows:
    """What a row holds, and how it is filled and read."""

    def __init__(self, model: Environments, watch: Watch) -> None:
        self._model = model
        self._watch = watch

    def shapes(self, rows: int) -> Shapes:
        """Shapes and types of tensors with so many rows."""
        import genesis

        model = self._model
        n_env = int(model.scene.n_envs)
        counts = dict.fromkeys((*(counter.name for counter in COUNTERS), _ERRORS), ((rows, n_env), genesis.tc_int))
        states = {name: ((rows, *shape), genesis.tc_float) for name, shape in model.parts().items()}
        return states | counts

    def row_bytes(self) -> int:
        """The bytes of a row on the device."""
        return sum(math.prod(shape) * dtype.itemsize for shape, dtype in self.shapes(1).values())

    def tensors(self, rows: int) -> dict[str, Any]:
        """So many rows on the device."""
        import genesis
        import torch

        return {
            name: torch.empty(shape, dtype=dtype, device=genesis.device)
            for name, (shape, dtype) in self.shapes(rows).items()
        }

    def store_state(self, tensors: Mapping[str, Any], row: int) -> None:
        """Enqueue: copy the present state."""
        self._model.store({name: tensors[name][row] for name in self._model.parts()})

    def store_evidence(self, tensors: Mapping[str, Any], row: int) -> None:
        """Enqueue: copy the counts of the last step, and the codes since they were last copied."""
        for counter, counted in zip(COUNTERS, self._watch.counts(), strict=True):
            tensors[counter.name][row] = counted
        self._watch.tell(tensors[_ERRORS][row])

    def split(self, rows: Host, envs: slice) -> States:
        """States [row, env of the range, item, width] from rows by name: views where the order is the same."""
        return self._model.split({name: rows(name)[:, envs] for name in self._model.parts()})

    def evidence(self, rows: Host) -> Evidence:
        """Counts and bits [row, env] from rows by name; the counts are these arrays, not copies."""
        return Evidence({counter.name: rows(counter.name) for counter in COUNTERS}, rows(_ERRORS).astype(np.uint32))


class TorchSlots(Slots):
    """Slots on a torch device."""

    def __init__(self, device: Any, shapes: Shapes) -> None:
        """device  torch.device
        shapes  with torch's dtypes
        """
        import torch

        on_gpu = device.type == "cuda"
        self._device = device
        self._copying: Any = torch.cuda.Stream(device) if on_gpu else None
        super().__init__(shapes, pinned=on_gpu)

    def _allocated(self, shape: tuple[int, ...], dtype: Any, *, pinned: bool) -> Any:
        import torch

        return torch.empty(shape, dtype=dtype, device="cpu" if pinned else self._device, pin_memory=pinned)

    def _copy(self, slot: Slot, rows: int) -> Any:
        import torch

        self._copying.wait_stream(torch.cuda.current_stream(self._copying.device))
        with torch.cuda.stream(self._copying):
            for name, array in slot.arrays.items():
                slot.host[name][:rows].copy_(array[:rows], non_blocking=True)
        # a thread that waits for a blocking event leaves the processor to those that write
        return self._copying.record_event(slot.copied or torch.cuda.Event(blocking=True))

    def _wait_for(self, event: Any) -> None:
        event.synchronize()
