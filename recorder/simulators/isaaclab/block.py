"""Steps of Isaac Lab on their way to a recording."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots

if TYPE_CHECKING:  # it imports MuJoCo
    from gpusimbench.recorder.simulators.isaaclab.world import World

STATES = ("positions", "velocities")
"""The arrays of a slot, in the order of World.state."""


class IsaacLabBlock(SlotBlock):
    """Positions and velocities of steps in a slot."""

    def __init__(self, slots: Slots, slot: Slot, rows: int, world: World, evidence: Evidence | None) -> None:
        """world     which knows the fields
        evidence  of the steps, on the host
        """
        super().__init__(slots, slot, rows)
        self._world = world
        self._evidence = evidence

    def states(self, envs: slice) -> States:
        """See Captured.states."""
        positions, velocities = (self.host(name)[:, envs] for name in STATES)
        return self._world.split(positions, velocities)

    def evidence(self) -> Evidence | None:
        """See Captured.evidence."""
        return self._evidence
