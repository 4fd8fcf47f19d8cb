"""PhysX with nothing around it: PhysX.step_sync, after a write of the targets of the drives."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.bare.loop import Built


class Bare(Built):
    """See loop.Loop."""

    def step(self, first_step: int, n_step: int) -> float:
        """See Loop.step."""
        import warp as wp

        physx, dt, device = self.simulator._session.physx, self.work.asked.dt, self.simulator._device
        actions, arms = self.work.actions(first_step, n_step), self.simulator._arms
        rows: list[Any] = []
        targets: Any = None
        if actions is not None:
            ordered = np.empty_like(actions)
            ordered[:, arms._rows] = actions  # environments in the engine's order
            moved = wp.array(ordered, dtype=wp.float32, device=device)
            rows, targets = [moved[i] for i in range(n_step)], arms._bindings["POSITION_TARGET"]
        self.simulator._start = None  # the adapter's note that nothing has stepped yet
        wp.synchronize_device(device)
        began = time.perf_counter()
        for i in range(n_step):
            if rows:
                targets.write(rows[i])
            physx.step_sync(dt)
        wp.synchronize_device(device)
        return time.perf_counter() - began
