"""MJX (jax) with nothing around it, on the work of a recording: python -m benchmarks.bare_mjx RECORDING.

One compiled ``jax.lax.scan`` of mjx.step with the recording's model, initial state, environments, warm-up, timed steps
and actions. The actions are drawn on the host and lie on the device before the clock is read.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.work import Done, Work
from gpusimbench.evaluator.metrics.throughput import frames_per_second


def main() -> None:
    """Step and print."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    import jax
    from mujoco import mjx

    from gpusimbench.recorder.simulators.mjx import physics

    work = Work(Path(sys.argv[1]), physics.MjxOptions)
    asked = work.asked
    device = jax.devices()[0]
    model = physics.load(
        work.scene, n_env=asked.n_env, dt=asked.dt, seed=asked.seed, options=work.options, impl="jax"
    )  # fmt: skip
    on_device, first = model.put(device), model.first_data(device)
    state = jax.vmap(lambda _: first)(jax.numpy.arange(asked.n_env))
    step = jax.vmap(mjx.step, (None, 0))

    def actions(first_step: int, n_step: int) -> Any:
        drawn = work.actions(first_step, n_step)
        return None if drawn is None else jax.block_until_ready(jax.device_put(drawn, device))

    def body(data: Any, ctrl: Any) -> Any:
        return step(on_device, data if ctrl is None else data.replace(ctrl=ctrl)), None

    def compiled(n_step: int) -> Any:
        def rollout(data: Any, ctrls: Any) -> Any:
            return jax.lax.scan(body, data, ctrls, length=n_step)[0]

        return jax.jit(rollout, donate_argnums=0).lower(state, actions(0, n_step)).compile()

    if asked.warmup:
        state = jax.block_until_ready(compiled(asked.warmup)(state, actions(0, asked.warmup)))
    rollout, given = compiled(asked.timed_steps), actions(asked.warmup, asked.timed_steps)
    began = time.perf_counter()
    state = jax.block_until_ready(rollout(state, given))
    rate = frames_per_second(asked.n_env, asked.timed_steps, time.perf_counter() - began)
    same = work.same_states(model.compiled, *jax.device_get((state.qpos, state.qvel)))
    Done(rate, same, float(np.mean(jax.device_get(model.count(state)["contacts"])))).show()


if __name__ == "__main__":
    main()
