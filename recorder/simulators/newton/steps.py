"""Steps of Newton's worlds: on a GPU as CUDA graphs, which are captured once and replayed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gpusimbench.recorder.simulators.newton.ring import Ring
    from gpusimbench.recorder.simulators.newton.watch import Watch
    from gpusimbench.recorder.simulators.newton.worlds import Worlds

BLOCK = 10
"""Steps in a graph; even, so that it ends with the state that it began with."""


class Steps:
    """Steps of some worlds, each followed by a row of `ring` where there is one."""

    def __init__(
        self,
        worlds: Worlds,
        watch: Watch,
        ring: Ring | None,
        *,
        substeps: int,
        device: Any,
        refusals: Callable[[], AbstractContextManager[None]],
    ) -> None:
        """Capture the graphs; nothing is executed.

        substeps  of a step
        device    Warp's
        refusals  what says so where the engine does not take what it is given
        """
        self._worlds, self._watch, self._ring = worlds, watch, ring
        self._substeps = substeps
        self._device = device
        self._refusals = refusals
        self._graphs: dict[tuple[int, int], Any] = {}  # by number of steps, and parity of the state they begin with
        if device.is_cuda:
            for parity in (0,) if substeps % 2 == 0 else (0, 1):
                for n_step in (1, BLOCK):
                    self._graphs[n_step, parity] = self._captured(n_step, parity)

    def enqueue(self, n_step: int) -> None:
        """Have the device make steps, in order with what it was given before."""
        if not self._device.is_cuda:
            self._enqueue(n_step)
            return
        import warp as wp

        worlds = self._worlds
        while n_step:
            size = BLOCK if n_step >= BLOCK else 1
            wp.capture_launch(self._graphs[size, worlds.parity])
            worlds.parity = (worlds.parity + size * self._substeps) % 2
            n_step -= size

    def _captured(self, n_step: int, parity: int) -> Any:
        import warp as wp

        present = self._worlds.parity
        self._worlds.parity = parity
        with self._refusals(), wp.ScopedCapture(self._device) as capture:
            self._enqueue(n_step)
        self._worlds.parity = present
        return capture.graph

    def _enqueue(self, n_step: int) -> None:
        for _ in range(n_step):
            self._worlds.act()
            for _ in range(self._substeps):
                self._worlds.substep()
                self._watch.gather()
            if self._ring is not None:
                self._ring.store()
