"""MuJoCo Warp with nothing around it, on the work of a recording: python -m benchmarks.bare_warp RECORDING.

On a GPU one CUDA graph is replayed for each step, after a copy of the step's actions, which lie on the device.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.work import Done, Work
from gpusimbench.evaluator.metrics.throughput import frames_per_second


def main() -> None:
    """Step and print."""
    import mujoco
    import mujoco_warp as mjw
    import warp as wp

    from gpusimbench.recorder.simulators.mujoco.model import compile_scene
    from gpusimbench.recorder.simulators.warp.options import WarpOptions

    work = Work(Path(sys.argv[1]), WarpOptions)
    asked = work.asked
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    compiled = compile_scene(work.scene, dt=asked.dt, options=work.options)
    compiled.model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # the engine does not know it
    model = mjw.put_model(compiled.model)
    sizes = {name: work.buffers[name] for name in ("nconmax", "njmax")}
    data = mjw.make_data(compiled.model, nworld=asked.n_env, **sizes)
    data.qpos.assign(np.tile(compiled.qpos0.astype(np.float32), (asked.n_env, 1)))
    data.qvel.assign(np.tile(compiled.qvel0.astype(np.float32), (asked.n_env, 1)))
    mjw.step(model, mjw.make_data(compiled.model, nworld=1, **sizes))  # builds the kernels
    on_gpu = wp.get_device().is_cuda
    if on_gpu:
        with wp.ScopedCapture() as captured:
            mjw.step(model, data)

    def run(first_step: int, n_step: int) -> float:
        drawn = work.actions(first_step, n_step)
        rows = [] if drawn is None else [wp.array(row, dtype=float) for row in drawn]
        wp.synchronize()
        began = time.perf_counter()
        for i in range(n_step):
            if rows:
                wp.copy(data.ctrl, rows[i])
            if on_gpu:
                wp.capture_launch(captured.graph)
            else:
                mjw.step(model, data)
        wp.synchronize()
        return time.perf_counter() - began

    run(0, asked.warmup)
    rate = frames_per_second(asked.n_env, asked.timed_steps, run(asked.warmup, asked.timed_steps))
    same = work.same_states(compiled, data.qpos.numpy(), data.qvel.numpy())
    Done(rate, same, float(data.nacon.numpy()[0]) / asked.n_env).show()


if __name__ == "__main__":
    main()
