"""A scene's actions, drawn or copied on the device step by step, as part of the step's graph."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.scenes.actions import JointTargets


class Drawn:
    """Where actions come from on Warp's present device.

    step  number of the next step, an array of one
    """

    def __init__(self, actions: JointTargets, seed: int) -> None:
        import warp as wp

        self.step = wp.zeros(1, dtype=wp.int32)
        table = actions.table()
        self._rows = None if table is None else wp.array(table, dtype=wp.float32)
        if self._rows is not None:
            return
        self._seed_word = wp.uint32(actions.seed_word(seed))
        kinds = (wp.int32, wp.uint32, wp.float32)
        self._range = [wp.array(a, dtype=kind) for a, kind in zip(actions.grid(), kinds, strict=True)]

    def enqueue(self, ctrl: Any) -> None:
        """Write the actions of the next step into ctrl [env, action], and go on to the step after it."""
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        if self._rows is not None:
            wp.launch(kernels.give_row, dim=ctrl.shape, inputs=[self.step, self._rows], outputs=[ctrl])
        else:
            inputs = [self._seed_word, self.step, *self._range]
            wp.launch(kernels.draw_targets, dim=ctrl.shape, inputs=inputs, outputs=[ctrl])
        wp.launch(kernels.advance, dim=1, inputs=[self.step])
