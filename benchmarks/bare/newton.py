"""Newton with nothing around it: collision detection and solver; on a GPU a CUDA graph of two steps is replayed.

Two steps, because a step reads one of two states and writes the other.
"""

from __future__ import annotations

import time

from benchmarks.bare.loop import Built
from benchmarks.bare.work import Work


class Bare(Built):
    """See loop.Loop; for scenes without actions, and even numbers of steps."""

    def __init__(self, work: Work) -> None:
        super().__init__(work)
        if work.scene.actions is not None:
            raise SystemExit("the bare loop of newton is for scenes without actions")
        import warp as wp

        worlds = self.simulator._worlds
        self._model, self._solver, self._control = worlds.model, worlds.solver, worlds.control
        self._pipeline, self._contacts = worlds.pipeline, worlds.contacts
        self._dt = work.asked.dt / work.options.substeps
        self._states = worlds.state, worlds._states[1 - worlds.parity]
        self._graph = None
        if wp.get_device().is_cuda:
            with wp.ScopedCapture() as captured:
                self._twice()
            self._graph = captured.graph

    def _twice(self) -> None:
        before, after = self._states
        for _ in range(2 * self.work.options.substeps):
            before.clear_forces()
            if self._pipeline is not None:
                self._pipeline.collide(before, self._contacts)
            self._solver.step(before, after, self._control, self._contacts, self._dt)
            before, after = after, before

    def step(self, first_step: int, n_step: int) -> float:
        """See Loop.step."""
        import warp as wp

        if n_step % 2:
            raise SystemExit("the bare loop of newton makes an even number of steps")
        wp.synchronize()
        began = time.perf_counter()
        for _ in range(n_step // 2):
            if self._graph is not None:
                wp.capture_launch(self._graph)
            else:
                self._twice()
        wp.synchronize()
        return time.perf_counter() - began
