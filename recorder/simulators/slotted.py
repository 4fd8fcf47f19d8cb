"""Adapters whose engines store captured steps in slots: what they have in common of the contract."""

from __future__ import annotations

from abc import abstractmethod

from gpusimbench.recorder.simulators.base import Simulator
from gpusimbench.recorder.simulators.captured import Captured, States, gathered
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.slots import Slot, Slots


class Slotted(Simulator):
    """An adapter that has slots once ``reserve`` was called; of longer blocks than a slot holds, it makes parts."""

    _slots: Slots | None = None
    _counted: Evidence | None = None
    """Of the last call of ``states``; None where the adapter has to ask its engine."""

    @abstractmethod
    def _fill(self, slots: Slots, slot: Slot, n_step: int) -> Captured:
        """Make these steps, store them in the first rows of the slot, and begin to copy it."""

    def begin_states(self, n_step: int) -> Captured:
        """See Simulator.begin_states."""
        self.reserve(n_step)
        assert self._slots is not None
        if n_step > self._slots.rows:
            return super().begin_states(n_step)
        return self._fill(self._slots, self._slots.take(), n_step)

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        self.reserve(n_step)
        assert self._slots is not None
        states, self._counted = gathered(self.begin_states, n_step, self._slots.rows)
        return states
