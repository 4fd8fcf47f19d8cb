"""A scene's actions, drawn or copied on the device step by step, bit for bit those of ``schemas.action_generator``."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.scenes.actions import table
from gpusimbench.schemas.action_generator import JointTargets, Streams


class DeviceActions:
    """Where actions come from on Warp's present device, by kernels that a graph may capture.

    step  number of the next step, an array of one
    """

    def __init__(self, actions: JointTargets, seed: int, streams: Streams) -> None:
        """seed, streams  as of JointTargets.draw"""
        import warp as wp

        self.step = wp.zeros(1, dtype=wp.int32)
        self._streams = [wp.array(a, dtype=wp.uint32) for a in (streams.env, streams.begun)]
        rows = table(actions)
        self._rows = None if rows is None else wp.array(rows, dtype=wp.float32)
        if self._rows is not None:
            return
        kinds = (wp.int32, wp.uint32, wp.float32)
        self._range = [wp.array(a, dtype=kind) for a, kind in zip(actions.grid(), kinds, strict=True)]
        self._seed_word = wp.uint32(actions.seed_word(seed))

    def follow(self, streams: Streams) -> None:
        """Go by these streams from now on, also in graphs that were captured before."""
        for array, numbers in zip(self._streams, (streams.env, streams.begun), strict=True):
            array.assign(numbers)

    def enqueue(self, ctrl: Any) -> None:
        """Write the actions of the next step into ctrl [env, action], and go on to the step after it."""
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        if self._rows is not None:
            inputs = [self.step, *self._streams, self._rows]
            wp.launch(kernels.give_row, dim=ctrl.shape, inputs=inputs, outputs=[ctrl])
        else:
            inputs = [self._seed_word, self.step, *self._streams, *self._range]
            wp.launch(kernels.draw_targets, dim=ctrl.shape, inputs=inputs, outputs=[ctrl])
        wp.launch(kernels.advance, dim=1, inputs=[self.step])
