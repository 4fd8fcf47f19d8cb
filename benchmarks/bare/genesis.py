"""Genesis with nothing around it: Scene.step, after the solver's own call for the targets of joints."""

from __future__ import annotations

import time

from benchmarks.bare.loop import Built
from gpusimbench.recorder.simulators.genesis import runtime


class Bare(Built):
    """See loop.Loop."""

    def step(self, first_step: int, n_step: int) -> float:
        """See Loop.step."""
        import genesis

        model = self.simulator._model
        actions = self.work.actions(first_step, n_step)
        drives = [] if actions is None else [(d.control, d.values, d.dofs) for d in model.drives(actions)]
        step = model.scene.step
        runtime.synchronise(genesis)
        began = time.perf_counter()
        for i in range(n_step):
            for control, values, dofs in drives:
                control(values[i], dofs)
            step(update_visualizer=False)
        runtime.synchronise(genesis)
        return time.perf_counter() - began
