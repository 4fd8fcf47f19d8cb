"""Steps of MuJoCo Warp on their way to a recording."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.counters import CONSTRAINT_ROWS, CONTACTS, SOLVER_ITERATIONS
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots


class WarpBlock(SlotBlock):
    """Positions, velocities, controls and counts of steps in a slot."""

    def __init__(self, slots: Slots, slot: Slot, rows: int, compiled: Any) -> None:
        """compiled  recorder.simulators.mujoco.model.MjcfModel, which knows where bodies are in qpos and qvel"""
        super().__init__(slots, slot, rows)
        self._compiled = compiled

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        qpos, qvel = (self.host(name)[:, envs] for name in ("qpos", "qvel"))
        states: States = self._compiled.split(qpos, qvel)
        return states

    def actions(self, envs: slice) -> NDArray[np.float32] | None:
        """See Captured.actions."""
        return self.host("ctrl")[:, envs] if "ctrl" in self._slot.arrays else None

    def evidence(self) -> Evidence:
        """See Captured.evidence."""
        return evidence_of(self.host("counts"))


def evidence_of(counts: NDArray[np.int32]) -> Evidence:
    """From counts [step, kind, env]: contacts, constraint rows, iterations, overflow bits."""
    return Evidence(
        {CONTACTS.name: counts[:, 0], CONSTRAINT_ROWS.name: counts[:, 1], SOLVER_ITERATIONS.name: counts[:, 2]},
        overflow=counts[:, 3].astype(np.uint32),
    )
