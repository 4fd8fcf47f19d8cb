"""States and counts of steps, kept on the device in rows of tensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.genesis.environments import Environments
from gpusimbench.recorder.simulators.genesis.watch import COUNTERS, Watch
from gpusimbench.recorder.simulators.slots import Shapes, Slot, SlotBlock, Slots

_ERRORS = "error_codes"
"""Counts have the names of their counters, states those that environments give them."""


class Rows:
    """What a row holds, and how it is filled and read."""

    def __init__(self, model: Environments, watch: Watch) -> None:
        self._model = model
        self._watch = watch

    def shapes(self, rows: int) -> Shapes:
        """Of tensors with so many rows."""
        import genesis

        model = self._model
        n_env = int(model.scene.n_envs)
        counts = dict.fromkeys((*(counter.name for counter in COUNTERS), _ERRORS), ((rows, n_env), genesis.tc_int))
        states = {name: ((rows, *shape), genesis.tc_float) for name, shape in model.parts().items()}
        return states | counts

    def row_bytes(self) -> int:
        """Of a row on the device."""
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

    def split(self, rows: Callable[[str], NDArray[Any]], envs: slice) -> States:
        """States [row, env of the range, item, width] from rows by name: views where the order is the same."""
        return self._model.split({name: rows(name)[:, envs] for name in self._model.parts()})

    def evidence(self, rows: Callable[[str], NDArray[Any]]) -> Evidence:
        """Counts and bits [row, env] from rows by name; the counts are these arrays, not copies."""
        return Evidence({counter.name: rows(counter.name) for counter in COUNTERS}, rows(_ERRORS).astype(np.uint32))


class GenesisBlock(SlotBlock):
    """Steps of Genesis on their way to a recording."""

    def __init__(self, slots: Slots, slot: Slot, rows: int, kept: Rows) -> None:
        super().__init__(slots, slot, rows)
        self._kept = kept

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        return self._kept.split(self.host, envs)

    def evidence(self) -> Evidence:
        """See Captured.evidence."""
        return self._kept.evidence(self.host)
