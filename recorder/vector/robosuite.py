"""Tasks of robosuite, observed as MuJoCo's state, begun in a recorded model and state."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from gpusimbench.recorder.vector.origin import SUITED, GivenEpisode
from gpusimbench.schemas.errors import UsageError

_UNSEEN = {
    "has_renderer": False, "has_offscreen_renderer": False, "use_camera_obs": False, "ignore_done": True,
}  # fmt: skip
"""Nothing is rendered, and no time limit ends an episode, as robomimic makes environments for its data sets."""

_ELSEWHERE = ("include", "extension", "plugin")  # elements of MJCF that load other files, or code
_PARTS = ("time", "qpos", "qvel")


def suited(name: str, keywords: Mapping[str, Any], n_env: int) -> Any:
    """Environments of robosuite in this process, each on its own, reset by their user.

    name  of robosuite's registry

    Raises what robosuite does; UsageError where it is not installed.
    """
    try:
        import robosuite
    except ImportError as error:
        raise UsageError(f"{name} needs robosuite: pip install robosuite ({error})") from None

    def made() -> Suited:
        return Suited(robosuite.make(name, **{**keywords, **_UNSEEN}), Path(robosuite.__file__).parent)

    envs = gymnasium.vector.SyncVectorEnv(
        [made] * n_env, autoreset_mode=gymnasium.vector.AutoresetMode.DISABLED, copy=False
    )
    envs.spec = gymnasium.envs.registration.EnvSpec(name, kwargs={**keywords, "vectorization_mode": SUITED})
    return envs


class Suited(gymnasium.Env):  # type: ignore[misc]
    """One environment of robosuite. Its observation is MuJoCo's state: time [s], qpos and qvel in units of the model.

    Its info is success, as the task judges its present state. No episode is over.
    """

    start: GivenEpisode | None = None

    def __init__(self, env: Any, assets: Path) -> None:
        self._env, self._assets = env, assets
        self.control_freq = float(env.control_freq)
        low, high = env.action_spec
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float64)
        self.observation_space = gymnasium.spaces.Dict(
            {name: gymnasium.spaces.Box(-np.inf, np.inf, one.shape, one.dtype) for name, one in self._state().items()}
        )

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """See Env.reset; robosuite takes no seed here. UsageError where the model or the state are not of the task."""
        self._env.reset()
        start, self.start = self.start, None
        if start is not None and start.state is not None:
            self._begin(start, np.concatenate([start.state[f"observation_{name}"] for name in _PARTS]))
        return self._state(), {}

    def step(self, action: Any) -> Any:
        """See Env.step."""
        _, reward, _, _ = self._env.step(action)
        return self._state(), float(reward), False, False, {"success": bool(self._env._check_success())}

    def close(self) -> None:
        """See Env.close."""
        self._env.close()

    def _begin(self, start: GivenEpisode, state: Any) -> None:
        if start.model is not None:
            model = self._env.edit_model_xml(without_entities(start.model))  # with robosuite's folder on this machine
            self._env.reset_from_xml_string(own_files_only(model, self._assets))
        self._env.sim.reset()
        if state.size != self._env.sim.get_state().flatten().size:
            raise UsageError(f"the recorded state has {state.size} numbers, and the model of the episode others")
        self._env.sim.set_state_from_flattened(state)
        self._env.sim.forward()

    def _state(self) -> dict[str, Any]:
        found = self._env.sim.get_state()
        return {"time": np.array([found.time]), "qpos": np.array(found.qpos), "qvel": np.array(found.qvel)}


def own_files_only(model: str, assets: Path) -> str:
    """The same MJCF; UsageError where it names a file outside a folder, or what loads more of them."""
    for element in ET.fromstring(model).iter():
        if element.tag in _ELSEWHERE:
            raise UsageError(f"the model of an episode has the element {element.tag}, which is not followed")
        for name, value in element.items():
            if name.startswith("file") and not Path(value).resolve().is_relative_to(assets.resolve()):
                raise UsageError(f"the model of an episode names a file that is not robosuite's: {value:.200}")
    return model


def without_entities(model: str) -> str:
    """The same XML; UsageError where it declares entities, of which a short text can make a very long one."""
    if "<!" in model.replace("<!--", ""):
        raise UsageError("the model of an episode declares entities, which are not read")
    return model
