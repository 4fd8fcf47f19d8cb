"""MJX: MuJoCo in JAX, or in Warp kernels that JAX calls."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import VARIED, Ability
from gpusimbench.recorder.simulators.jax.simulator import Physics
from gpusimbench.recorder.simulators.mjx import physics as mjx_physics
from gpusimbench.recorder.simulators.mjx.physics import MjxModel, MjxOptions
from gpusimbench.recorder.simulators.mjx.stepper import MjxSimulator


class Mjx(MjxSimulator):
    """N environments: mjx.step, vmapped over a batched mjx.Data."""

    Options = MjxOptions
    name = "mjx"
    distribution = "mujoco-mjx"
    covers = "a compiled loop (jax.lax.fori_loop) of vmapped mjx.step over all environments"
    abilities = MjxSimulator.abilities | frozenset(VARIED.values())

    @classmethod
    def withheld(cls, options: Any) -> dict[Ability, str]:
        """See Simulator.withheld."""
        return {} if options.impl == "jax" else dict.fromkeys(VARIED.values(), "--impl jax")

    def _physics_of(self, model: MjxModel, on_device: Any, device: Any) -> Physics:
        import jax
        import jax.numpy as jnp
        from mujoco import mjx

        from gpusimbench.recorder.simulators.mjx.physics import batched

        model_on_device, axes = batched(on_device, model.varied) if model.varied else (on_device, None)
        step = jax.vmap(mjx.step, (axes, 0))

        # array by array, each copy would be a program of its own to compile
        copies = jax.jit(lambda one, qpos, qvel: jax.vmap(lambda q, v: one.replace(qpos=q, qvel=v))(qpos, qvel))

        def initial(qpos: Any, qvel: Any) -> Any:
            return copies(model.first_data(device, jnp.asarray(qpos[0]), jnp.asarray(qvel[0])), qpos, qvel)

        def advance(data: Any, actions: Any) -> Any:
            return step(model_on_device, data if actions is None else data.replace(ctrl=actions))

        return Physics(
            initial=initial,
            advance=advance,
            observe=mjx_physics.observe,
            count=model.count,
            kept=mjx_physics.kept,
            put=lambda data, arrays: data.replace(**arrays),
            forget=lambda data: mjx_physics.forget(data, model.impl),
            applied=lambda data: data.ctrl,
            lazy=model.impl == "warp",
            gathers=model.impl == "warp",
        )

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold."""
        import jax.numpy as jnp

        self._state = self._physics.put(self._state, {"ctrl": jnp.asarray(controls, jnp.float32)})
