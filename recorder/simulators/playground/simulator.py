"""MuJoCo Playground: an environment of its kind over MJX, stepped as training code steps them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from gpusimbench.recorder.options import one_of
from gpusimbench.recorder.simulators.jax.simulator import Physics
from gpusimbench.recorder.simulators.mjx import physics as mjx_physics
from gpusimbench.recorder.simulators.mjx.physics import IMPLEMENTATIONS, MjxModel, MjxOptions
from gpusimbench.recorder.simulators.mjx.simulator import MjxSimulator

_SHIPPED = "CartpoleBalance"  # an environment of the package's own, whose configuration has the package's defaults


@dataclass(frozen=True)
class PlaygroundOptions(MjxOptions):
    """Options of MJX.

    impl  empty: the one in the configurations of the package's own environments
    """

    impl: str = ""

    def _check_impl(self) -> None:
        one_of("impl", self.impl, ("", *IMPLEMENTATIONS))


class Playground(MjxSimulator):
    """N environments: the step of a mujoco_playground.MjxEnv, vmapped over its State."""

    Options = PlaygroundOptions
    name = "playground"
    distribution = "playground"
    covers = "a compiled loop (jax.lax.fori_loop) of the environment's vmapped step, observation included"

    @cached_property
    def _default(self) -> str:
        return str(_package().registry.get_default_config(_SHIPPED).impl)

    def _implementation(self) -> str:
        return self.options.impl or self._default

    def _physics_of(self, model: MjxModel, on_device: Any, device: Any) -> Physics:
        import jax
        import jax.numpy as jnp

        environment = _environment(model, self.dt, on_device, device)
        step = jax.vmap(environment.step)
        no_actions = jnp.zeros((self.n_env, environment.action_size), jnp.float32)

        def initial(qpos: Any, qvel: Any) -> Any:
            state = jax.vmap(environment.reset)(jax.random.split(jax.random.key(self.seed), self.n_env))
            return put(state, {"qpos": jnp.asarray(qpos), "qvel": jnp.asarray(qvel)})

        def put(state: Any, arrays: dict[str, Any]) -> Any:
            data = state.data.replace(**arrays)
            return state.replace(data=data, obs=jax.vmap(environment.observation)(data))

        return Physics(
            initial=initial,
            advance=lambda state, actions: step(state, no_actions if actions is None else actions),
            observe=lambda state: mjx_physics.observe(state.data),
            count=lambda state: model.count(state.data),
            kept=lambda state: mjx_physics.kept(state.data),
            put=put,
            forget=lambda state: state.replace(data=mjx_physics.forget(state.data, model.impl)),
            applied=lambda state: state.data.ctrl,
            lazy=model.impl == "warp",
            gathers=model.impl == "warp",
        )


def _package() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what it imports for training
        import mujoco_playground
    return mujoco_playground


def _environment(model: MjxModel, dt: float, on_device: Any, device: Any) -> Any:
    """A mujoco_playground.MjxEnv of a scene: no reward, no end, the whole state as observation."""
    import jax.numpy as jnp
    from ml_collections import config_dict

    mujoco_playground = _package()
    compiled = model.compiled

    class SceneEnv(mujoco_playground.MjxEnv):  # type: ignore[misc,name-defined]
        """The scene, one step of physics for each step of control."""

        def __init__(self) -> None:
            super().__init__(config_dict.create(ctrl_dt=dt, sim_dt=dt, impl=model.impl, **model.sizes))
            self._mjx_model = on_device

        def reset(self, rng: Any) -> Any:
            """The scene's initial state; nothing is drawn."""
            first = (jnp.asarray(numbers, jnp.float32) for numbers in (compiled.qpos0, compiled.qvel0))
            data = model.first_data(device, *first)
            zero = jnp.float32(0)
            return mujoco_playground.State(data, self.observation(data), zero, zero, {}, {"rng": rng})

        def step(self, state: Any, action: Any) -> Any:
            """One step of control."""
            data = mujoco_playground.step(self._mjx_model, state.data, action, self.n_substeps)
            return state.replace(data=data, obs=self.observation(data))

        def observation(self, data: Any) -> Any:
            """All positions and velocities."""
            return jnp.concatenate([data.qpos, data.qvel])

        xml_path = property(lambda self: "")
        action_size = property(lambda self: compiled.model.nu)
        mj_model = property(lambda self: compiled.model)
        mjx_model = property(lambda self: self._mjx_model)

    return SceneEnv()
