"""MJX (jax) with nothing around it: one compiled jax.lax.scan of mjx.step.

The model and the initial state are those of the recorder. Actions are drawn on the host and lie on the device before
the clock is read.
"""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from benchmarks.bare.loop import Loop
from benchmarks.bare.work import Work
from gpusimbench.recorder.simulators.base import States


class Bare(Loop):
    """See loop.Loop."""

    def __init__(self, work: Work) -> None:
        os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
        import jax
        from mujoco import mjx

        from gpusimbench.recorder.simulators.mjx import physics

        self._work, asked = work, work.asked
        self._device = jax.devices()[0]
        model = self._loaded = physics.load(
            work.scene, n_env=asked.n_env, dt=asked.dt, seed=asked.seed, options=work.options, impl="jax"
        )
        on_device = model.put(self._device)
        start = (jax.numpy.asarray(array) for array in (model.compiled.qpos0, model.compiled.qvel0))
        first = model.first_data(self._device, *start)
        self._state = jax.vmap(lambda _: first)(jax.numpy.arange(asked.n_env))
        step = jax.vmap(mjx.step, (None, 0))

        def body(data: Any, ctrl: Any) -> Any:
            return step(on_device, data if ctrl is None else data.replace(ctrl=ctrl)), None

        def rollout(data: Any, ctrls: Any, n_step: int) -> Any:
            return jax.lax.scan(body, data, ctrls, length=n_step)[0]

        self._rollout = jax.jit(rollout, static_argnums=2, donate_argnums=0)
        self._compiled: dict[int, Any] = {}  # by the number of steps

    def step(self, first_step: int, n_step: int) -> float:
        """See Loop.step."""
        import jax

        if not n_step:
            return 0.0
        drawn = self._work.actions(first_step, n_step)
        actions = None if drawn is None else jax.block_until_ready(jax.device_put(drawn, self._device))
        if n_step not in self._compiled:
            self._compiled[n_step] = self._rollout.lower(self._state, actions, n_step).compile()
        began = time.perf_counter()
        self._state = jax.block_until_ready(self._compiled[n_step](self._state, actions))
        return time.perf_counter() - began

    def state(self) -> States:
        """See Loop.state."""
        import jax

        state: States = self._loaded.compiled.split(*jax.device_get((self._state.qpos, self._state.qvel)))
        return state

    def contacts(self) -> float | None:
        """See Loop.contacts."""
        import jax

        return float(np.mean(jax.device_get(self._loaded.count(self._state)["contacts"])))
