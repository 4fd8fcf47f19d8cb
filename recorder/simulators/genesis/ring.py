"""States and counts of consecutive steps, kept on the device until they are read together."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.genesis.model import Model
from gpusimbench.recorder.simulators.genesis.watch import COUNTERS, Watch

_LINK = 13  # position 3, orientation wxyz 4, linear velocity 3, angular velocity 3
_HINGE = 2  # angle, speed


class Ring:
    """Rows that are stored in order from 0 and read once.

    rows  for which there is room
    """

    def __init__(self, model: Model, watch: Watch, rows: int) -> None:
        import genesis
        import torch

        solver, n_env = model.solver, model.scene.n_envs
        self.rows = rows
        self._model = model
        self._watch = watch
        self._next = 0
        n_link = solver.n_links if model.links.size else 0
        self._links = torch.empty((rows, n_env, n_link, _LINK), dtype=genesis.tc_float, device=genesis.device)
        self._joints = torch.empty(
            (rows, n_env, len(model.joints), _HINGE), dtype=genesis.tc_float, device=genesis.device
        )
        self._counts = torch.empty((rows, len(COUNTERS), n_env), dtype=genesis.tc_int, device=genesis.device)
        self._errors = torch.empty((rows, n_env), dtype=genesis.tc_int, device=genesis.device)

    @staticmethod
    def row_bytes(model: Model) -> int:
        """Of one row on the device, at most."""
        numbers = int(model.solver.n_links) * _LINK + len(model.joints) * _HINGE + len(COUNTERS) + 1
        return 8 * numbers * int(model.scene.n_envs)

    def rewind(self) -> None:
        """Begin again with row 0."""
        self._next = 0

    def store(self) -> None:
        """Copy the present state and the counts of the last step into the next row."""
        row, solver = self._next, self._model.solver
        if self._links.shape[2]:
            links = self._links[row]
            links[..., 0:3] = solver.get_links_pos()
            links[..., 3:7] = solver.get_links_quat()
            links[..., 7:10] = solver.get_links_vel()
            links[..., 10:13] = solver.get_links_ang()
        if self._joints.shape[2]:
            joints = self._joints[row]
            joints[..., 0] = solver.get_dofs_position(self._model.joints)
            joints[..., 1] = solver.get_dofs_velocity(self._model.joints)
        for place, counted in enumerate(self._watch.counts()):
            self._counts[row, place] = counted
        self._errors[row] = self._watch.tell()
        self._next += 1

    def links(self) -> NDArray[np.floating]:
        """Of the moving bodies, shape [row, env, body, 13]."""
        return self._read(self._links)[:, :, self._model.links]

    def joints(self) -> NDArray[np.floating]:
        """Of the robot, shape [row, env, joint, 2]."""
        return self._read(self._joints)

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
