"""Action streams drawn on the device, bit for bit what ``recorder.scenes.actions`` draws on the host."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.scenes.actions import JointTargets, Streams


class DeviceDraw:
    """The actions of a scene, drawn by a kernel that a graph may capture, on Warp's default device."""

    def __init__(self, actions: JointTargets, seed: int, streams: Streams) -> None:
        """seed, streams  as of JointTargets.draw"""
        import warp as wp

        kinds = (wp.int32, wp.uint32, wp.float32)
        self._range = [wp.array(a, dtype=kind) for a, kind in zip(actions.grid(), kinds, strict=True)]
        self._streams = [wp.array(a, dtype=wp.uint32) for a in (streams.env, streams.begun)]
        self._seed_word = wp.uint32(actions.seed_word(seed))

    def follow(self, streams: Streams) -> None:
        """Draw by these streams from now on, also in graphs that were captured before."""
        for array, numbers in zip(self._streams, (streams.env, streams.begun), strict=True):
            array.assign(numbers)

    def launch(self, step: Any, ctrl: Any) -> None:
        """Into ctrl, a Warp array [env, action], the actions of the step that `step`, an array of one, holds; counts
        it up."""
        import warp as wp

        from gpusimbench.recorder.simulators.warp import kernels

        wp.launch(
            kernels.draw_targets,
            dim=ctrl.shape,
            inputs=[self._seed_word, step, *self._streams, *self._range],
            outputs=[ctrl],
        )
        wp.launch(kernels.advance, dim=1, inputs=[step])
