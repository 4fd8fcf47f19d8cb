"""Steps of PhysX on their way to a recording."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots


class PhysxBlock(SlotBlock):
    """States of steps in a slot, as what gathers them has stored them."""

    def __init__(self, slots: Slots, slot: Slot, rows: int, source: Any) -> None:
        """source  the Bodies, Arms or Articulations"""
        super().__init__(slots, slot, rows)
        self._source = source

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        states: States = self._source.split(self.host("states"), envs)
        return states

    def evidence(self) -> None:
        """See Captured.evidence: PhysX tells nothing."""
        return
