"""Isaac Lab with nothing around it: SimulationContext.step, and the update of each collection of bodies."""

from __future__ import annotations

import time

from benchmarks.bare.loop import Built
from benchmarks.bare.work import Work


class Bare(Built):
    """See loop.Loop; for scenes of bodies."""

    def __init__(self, work: Work) -> None:
        super().__init__(work)
        if work.scene.robot is not None:
            raise SystemExit("the bare loop of isaaclab is for scenes of bodies")

    def step(self, first_step: int, n_step: int) -> float:
        """See Loop.step."""
        import warp as wp

        world, dt, device = self.simulator._world, self.work.asked.dt, self.simulator._device
        step, collections = world.sim.step, world._collections
        wp.synchronize_device(device)
        began = time.perf_counter()
        for _ in range(n_step):
            step(render=False)
            for collection in collections:
                collection.update(dt)
        wp.synchronize_device(device)
        self.simulator._stepped = True  # the adapter has not counted these steps yet
        return time.perf_counter() - began
