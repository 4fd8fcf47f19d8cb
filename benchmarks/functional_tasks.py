"""Functional environments on JAX, for benchmarks: of MuJoCo Playground, of Brax, and of MJX alone."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp

_LONGEST = 100  # steps of an episode
_LEGS = """
<mujoco>
  <option timestep="0.005" iterations="4" ls_iterations="8"/>
  <default><joint damping="1" armature="0.1" range="-50 50" limited="true"/><geom density="200" friction="1"/></default>
  <worldbody>
    <geom type="plane" size="0 0 1"/>
    <body pos="0 0 0.45">
      <freejoint/>
      <geom type="sphere" size="0.2"/>
      {legs}
    </body>
  </worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
_LEG = """
<body pos="{x} {y} 0"><joint name="hip{i}" axis="0 0 1"/><geom type="capsule" size="0.06" fromto="0 0 0 {x} {y} 0"/>
<body pos="{x} {y} 0"><joint name="knee{i}" axis="{v} {x} 0"/>
<geom type="capsule" size="0.06" fromto="0 0 0 {x} {y} -0.3"/></body></body>
"""
_CORNERS = ((0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.2, -0.2))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """What such environments return."""

    data: Any
    obs: Any
    reward: Any
    done: Any
    info: dict[str, Any] = field(default_factory=dict)

    replace = replace


class Walker:
    """A body on four legs of two motors each, in MJX: 19 + 18 observations, 8 actions, reset within step."""

    action_size = 8

    def __init__(self) -> None:
        import mujoco
        from mujoco import mjx

        legs = "".join(_LEG.format(i=i, x=x, y=y, v=-y) for i, (x, y) in enumerate(_CORNERS))
        motors = "".join(f'<motor joint="{joint}{i}" gear="15"/>' for i in range(4) for joint in ("hip", "knee"))
        model = mujoco.MjModel.from_xml_string(_LEGS.format(legs=legs, motors=motors))
        self._mjx, self._model, self.dt = mjx, mjx.put_model(model, impl="jax"), model.opt.timestep

    def reset(self, rng: Any) -> State:
        """The states of as many environments as there are keys."""
        data = self._mjx.make_data(self._model)

        def begun(key: Any) -> Any:
            return data.replace(qvel=0.1 * jax.random.normal(key, data.qvel.shape))

        all_data = jax.vmap(begun)(rng)
        zeros = jnp.zeros(len(rng))
        info = {"steps": zeros, "truncation": zeros, "first_data": all_data, "first_obs": _seen(all_data)}
        return State(all_data, info["first_obs"], zeros, zeros, info)

    def step(self, state: State, action: Any) -> State:
        """The next states; those whose episode ends are the first ones again."""
        data = jax.vmap(lambda one, ctrl: self._mjx.step(self._model, one.replace(ctrl=ctrl)))(state.data, action)
        steps = jnp.where(state.done, 0, state.info["steps"]) + 1
        done, cut = data.qpos[:, 2] < 0.2, steps >= _LONGEST
        ended = done | cut

        def chosen(first: Any, other: Any) -> Any:
            return jnp.where(ended.reshape(-1, *(1,) * (other.ndim - 1)), first, other)

        info = {**state.info, "steps": steps, "truncation": (cut & ~done).astype(float)}
        reward = data.qvel[:, 0] - 0.1 * jnp.square(action).sum(axis=1)
        obs = chosen(info["first_obs"], _seen(data))
        return State(jax.tree.map(chosen, info["first_data"], data), obs, reward, ended.astype(float), info)


def task(kind: str, name: str) -> Any:
    """A task whose reset and step are compiled once, for all who use it.

    kind  playground (package playground), brax (brax) or mjx (mujoco-mjx)
    name  of the task, of playground and brax
    """
    if kind == "playground":
        from mujoco_playground import registry, wrapper

        env = wrapper.wrap_for_brax_training(registry.load(name), episode_length=_LONGEST)
    elif kind == "brax":
        from brax import envs

        env = envs.training.wrap(envs.get_environment(name, backend="generalized"), episode_length=_LONGEST)
    else:
        env = Walker()
    return SimpleNamespace(
        reset=jax.jit(env.reset), step=jax.jit(env.step), dt=float(env.dt), action_size=env.action_size, unwrapped=env
    )


def _seen(data: Any) -> Any:
    return jnp.concatenate([data.qpos, data.qvel], axis=1)
