"""States and counts of consecutive steps, kept on the device until they are read together."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.genesis.environments import Environments
from gpusimbench.recorder.simulators.genesis.watch import COUNTERS, Watch


class Ring:
    """Rows that are stored in order from 0 and read once.

    rows  for which there is room
    """

    def __init__(self, model: Environments, watch: Watch, rows: int) -> None:
        import genesis
        import torch

        n_env = model.scene.n_envs
        self.rows = rows
        self._model = model
        self._watch = watch
        self._next = 0
        self._states = torch.empty((rows, n_env, model.width), dtype=genesis.tc_float, device=genesis.device)
        self._counts = torch.empty((rows, len(COUNTERS), n_env), dtype=genesis.tc_int, device=genesis.device)
        self._errors = torch.empty((rows, n_env), dtype=genesis.tc_int, device=genesis.device)

    @staticmethod
    def row_bytes(model: Environments) -> int:
        """Of one row on the device, at most."""
        return 8 * (model.width + len(COUNTERS) + 1) * int(model.scene.n_envs)

    def rewind(self) -> None:
        """Begin again with row 0."""
        self._next = 0

    def store(self) -> None:
        """Copy the present state and the counts of the last step into the next row."""
        row = self._next
        self._model.store(self._states[row])
        for place, counted in enumerate(self._watch.counts()):
            self._counts[row, place] = counted
        self._errors[row] = self._watch.tell()
        self._next += 1

    def states(self) -> States:
        """An array [row, env, item, width] for each field."""
        return self._model.split(self._read(self._states))

    def evidence(self) -> Evidence:
        """Of all rows."""
        counts = self._read(self._counts)
        return Evidence(
            {counter.name: counts[:, place] for place, counter in enumerate(COUNTERS)},
            self._read(self._errors).astype(np.uint32),
        )

    def _read(self, tensor: Any) -> NDArray[Any]:
        # a copy, also where the device is the host
        return np.array(tensor[: self._next].cpu().numpy())
