"""MuJoCo Warp with nothing around it, built here: on a GPU one CUDA graph is replayed for each step.

Before it, the step's actions are copied; they lie on the device.
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.bare.loop import Loop
from benchmarks.bare.work import Work
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.mujoco.model import compile_scene


class Bare(Loop):
    """See loop.Loop."""

    def __init__(self, work: Work) -> None:
        import mujoco
        import mujoco_warp as mjw
        import warp as wp

        self._work, n_env = work, work.asked.n_env
        wp.config.log_level = wp.LOG_WARNING
        wp.init()
        compiled = self._compiled = compile_scene(work.scene, dt=work.asked.dt, options=work.options)
        compiled.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # the engine does not know it
        self._model = mjw.put_model(compiled.model)
        sizes = {name: work.buffers[name] for name in ("nconmax", "njmax")}
        data = self._data = mjw.make_data(compiled.model, nworld=n_env, **sizes)
        data.qpos.assign(np.tile(compiled.qpos0.astype(np.float32), (n_env, 1)))
        data.qvel.assign(np.tile(compiled.qvel0.astype(np.float32), (n_env, 1)))
        mjw.step(self._model, mjw.make_data(compiled.model, nworld=1, **sizes))  # builds the kernels
        self._graph = None
        if wp.get_device().is_cuda:
            with wp.ScopedCapture() as captured:
                mjw.step(self._model, data)
            self._graph = captured.graph

    def step(self, first_step: int, n_step: int) -> float:
        """See Loop.step."""
        import mujoco_warp as mjw
        import warp as wp

        model, data, graph = self._model, self._data, self._graph
        drawn = self._work.actions(first_step, n_step)
        rows = [] if drawn is None else [wp.array(row, dtype=float) for row in drawn]
        wp.synchronize()
        began = time.perf_counter()
        for i in range(n_step):
            if rows:
                wp.copy(data.ctrl, rows[i])
            if graph is not None:
                wp.capture_launch(graph)
            else:
                mjw.step(model, data)
        wp.synchronize()
        return time.perf_counter() - began

    def state(self) -> States:
        """See Loop.state."""
        return self._compiled.split(self._data.qpos.numpy(), self._data.qvel.numpy())

    def contacts(self) -> float | None:
        """See Loop.contacts."""
        return float(self._data.nacon.numpy()[0]) / self._work.asked.n_env
