"""Steps of MuJoCo Warp on their way to a recording."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.captured import Captured, States
from gpusimbench.recorder.simulators.counters import CONSTRAINT_ROWS, CONTACTS, SOLVER_ITERATIONS
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.warp.transfer import Slot, Slots


class WarpBlock(Captured):
    """The first rows of a slot, which goes back to its kind when they were read."""

    def __init__(self, slots: Slots, slot: Slot, rows: int, compiled: Any) -> None:
        """compiled  recorder.simulators.mujoco.model.MjcfModel, which knows where bodies are in qpos and qvel"""
        self._slots = slots
        self._slot = slot
        self._rows = rows
        self._compiled = compiled

    def wait(self) -> None:
        """See Captured.wait."""
        self._slot.wait()

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        qpos, qvel = (self._slot.host(name, self._rows)[:, envs] for name in ("qpos", "qvel"))
        states: States = self._compiled.split(qpos, qvel)
        return states

    def actions(self, envs: slice) -> NDArray[np.float32] | None:
        """See Captured.actions."""
        return self._slot.host("ctrl", self._rows)[:, envs] if "ctrl" in self._slot.arrays else None

    def evidence(self) -> Evidence:
        """See Captured.evidence."""
        return evidence_of(self._slot.host("counts", self._rows))

    def release(self) -> None:
        """See Captured.release."""
        self._slots.give_back(self._slot)


def evidence_of(counts: NDArray[np.int32]) -> Evidence:
    """From counts [step, kind, env]: contacts, constraint rows, iterations, overflow bits."""
    return Evidence(
        {CONTACTS.name: counts[:, 0], CONSTRAINT_ROWS.name: counts[:, 1], SOLVER_ITERATIONS.name: counts[:, 2]},
        overflow=counts[:, 3].astype(np.uint32),
    )
