"""Tasks of ManiSkill, observed as their whole state, so that states can be compared and episodes begin in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.fields import field_of
from gpusimbench.recorder.vector.open_loop import Started
from gpusimbench.recorder.vector.origin import STATED, State
from gpusimbench.schemas.errors import UsageError

_UNSEEN = {"obs_mode": "none", "render_mode": None}
"""Nothing is observed but the state, so that no camera has to be rendered."""

_FLAGS = ("success", "fail")


def stated(spec_id: str, keywords: Mapping[str, Any], n_env: int) -> Any:
    """Environments of ManiSkill in this process, each on its own, reset by their user.

    Raises what ManiSkill does; UsageError where it is not installed.
    """
    try:
        import mani_skill.envs  # noqa: F401  registers its tasks
    except ImportError as error:
        raise UsageError(f"{spec_id} needs ManiSkill: pip install mani-skill ({error})") from None

    def made() -> Stated:
        return Stated(gymnasium.make(spec_id, **{**keywords, **_UNSEEN, "num_envs": 1}))

    envs = gymnasium.vector.SyncVectorEnv(
        [made] * n_env, autoreset_mode=gymnasium.vector.AutoresetMode.DISABLED, copy=False
    )
    spec = gymnasium.spec(spec_id.rpartition(":")[2])  # which the module before the id has registered by now
    longest = keywords.get("max_episode_steps", spec.max_episode_steps)
    told = {name: value for name, value in keywords.items() if name != "max_episode_steps"}
    envs.spec = replace(spec, kwargs={**told, "vectorization_mode": STATED}, max_episode_steps=longest)
    return envs


class Stated(Started):
    """One environment of ManiSkill with arrays of numpy, without the axis of environments.

    Its observation is what get_state_dict returns: for each body 13 numbers (position [m], quaternion wxyz, velocity
    [m/s], angular velocity [rad/s]), for each articulation those of its root and the positions and velocities of its
    joints, and, of some controllers, their targets. No episode is over: ManiSkill's demonstrations go on after they
    have succeeded, and after the time limit. Its infos are success and fail, where the task has them.
    """

    def __init__(self, env: Any) -> None:
        super().__init__(env)
        self.observation_space = _space(self._state())
        self.action_space = self.unwrapped.single_action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """See Env.reset. UsageError where the task cannot be brought into the state."""
        self.env.reset(seed=seed, options=options)
        start, self.start = self.start, None
        return (self._state() if start is None or start.state is None else self.begun(start.state)), {}

    def step(self, action: Any) -> Any:
        """See Env.step."""
        _, reward, _, _, info = self.env.step(action)
        flags = {name: bool(_host(info[name]).reshape(-1)[0]) for name in _FLAGS if name in info}
        return self._state(), float(_host(reward).reshape(-1)[0]), False, False, flags

    def begun(self, state: State) -> Any:
        """Bring the task into a state; returns what it is then.

        What the reset has led to bit for bit is left alone, since setting it would round it. What is not of the task
        is passed over, and what only the task has stays as it was reset.
        """
        now = self._state()
        wanted = _filled(now, state)
        other = _differing(wanted, now)
        task = self.unwrapped
        if other:
            task.set_state_dict(_tensors(other, task.device))
        if {"articulations", "controller"} & other.keys():
            controllers = task.agent.controller  # of several robots by their names
            for one in controllers.values() if isinstance(controllers, Mapping) else (controllers,):
                one.reset()  # as ManiSkill's reset does, since targets depend on the joints
            if "controller" in wanted:
                task.agent.set_controller_state(_tensors(wanted["controller"], task.device))
        return self._state()

    def _state(self) -> dict[str, Any]:
        found: dict[str, Any] = _unbatched(self.unwrapped.get_state_dict())
        return found


def _unbatched(node: Any) -> Any:
    if isinstance(node, Mapping):
        return {name: _unbatched(one) for name, one in node.items() if not isinstance(one, Mapping) or one}
    return np.array(_host(node)[0])


def _host(array: Any) -> NDArray[Any]:
    return np.asarray(array.cpu() if hasattr(array, "cpu") else array)


def _tensors(node: Any, device: Any) -> Any:
    import torch

    if isinstance(node, Mapping):
        return {name: _tensors(one, device) for name, one in node.items()}
    return torch.as_tensor(node, device=device)[None]


def _filled(now: Mapping[str, Any], state: State, name: str = "observation") -> dict[str, Any]:
    """The tree of the present state with the arrays of another one, where that has them in the same shape."""
    found: dict[str, Any] = {}
    for key, node in now.items():
        called = f"{name}/{key}"
        if isinstance(node, Mapping):
            found[key] = _filled(node, state, called)
            continue
        given = state.get(field_of(called, node.dtype, node.shape).field)
        same = given is not None and given.size == node.size
        found[key] = given.reshape(node.shape).astype(node.dtype) if same and given is not None else node
    return found


def _differing(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a tree whose arrays have other bits than those of another one."""
    found: dict[str, Any] = {}
    for key, node in a.items():
        other = _differing(node, b[key]) if isinstance(node, Mapping) else node
        if other if isinstance(node, Mapping) else node.tobytes() != b[key].tobytes():
            found[key] = other
    return found


def _space(node: Any) -> Any:
    if isinstance(node, Mapping):
        return gymnasium.spaces.Dict({name: _space(one) for name, one in node.items()})
    return gymnasium.spaces.Box(-np.inf, np.inf, node.shape, node.dtype)
