"""The VecEnv of Stable-Baselines3 in gpusimbench.wrap: its interface for the trainer, Gymnasium's for the recording."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnvWrapper

from gpusimbench.recorder.vector.fields import FINAL_INFO
from gpusimbench.recorder.vector.wrapper import Recorded

_CUT, _FINAL = "TimeLimit.truncated", "terminal_observation"


class AsGymnasium(gymnasium.vector.VectorEnv):  # type: ignore[misc]
    """A VecEnv as Gymnasium's VectorEnv, which resets an environment in the step that ends its episode.

    venv   what it is of
    infos  names of the infos that step returns, "a/b" for b in the dictionary a
    told   what the last call of step or reset of the VecEnv returned
    reward_dtype  of its rewards: a DummyVecEnv rounds what the tasks return

    A VecEnv says whether the time limit alone ended an episode (the info "TimeLimit.truncated"): an episode that the
    task ends in the last step of its time is terminated here, and not truncated.
    """

    def __init__(self, venv: Any, infos: Sequence[str]) -> None:
        self.venv = venv
        self.told: Any = None
        self.num_envs = venv.num_envs
        self.single_observation_space, self.single_action_space = venv.observation_space, venv.action_space
        self.observation_space = gymnasium.vector.utils.batch_space(venv.observation_space, venv.num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(venv.action_space, venv.num_envs)
        # through the VecEnv, since the environments may live in other processes
        (of_task,), (self.spec,) = (venv.get_attr(name, [0]) for name in ("metadata", "spec"))
        self.metadata = {**(of_task or {}), "autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}
        self.reward_dtype = getattr(vars(venv).get("buf_rews"), "dtype", np.dtype(np.float64))
        self._keys = {name.split("/")[0] for name in infos}

    @property
    def envs(self) -> Sequence[Any]:
        """The environments, where they live in this process."""
        return getattr(self.venv.unwrapped, "envs", ())

    def reset(self, *, seed: Any = None, options: Any = None) -> Any:
        """See VectorEnv.reset. The seeds are those that VecEnv.seed was given before; this one is not passed on."""
        self.told = self.venv.reset()
        return self.told, {}

    def step(self, actions: Any) -> Any:
        """See VectorEnv.step."""
        self.venv.step_async(actions)
        self.told = observation, reward, done, infos = self.venv.step_wait()
        cut = np.array([bool(info.get(_CUT, False)) for info in infos])
        return observation, reward, done & ~cut, done & cut, self._infos(done, infos)

    def close_extras(self, **keywords: Any) -> None:
        """Close the VecEnv."""
        self.venv.close()

    def _infos(self, done: Any, infos: Any) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for env, info in enumerate(infos):
            asked = {key: info[key] for key in self._keys if key in info}
            # a VecEnv keeps the infos of the reset that follows elsewhere: these are of the episode's last step
            found = self._add_info(found, {**asked, FINAL_INFO: asked} if done[env] else asked, env)
        if done.any() and all(_FINAL in infos[over] for over in np.flatnonzero(done)):
            final = np.full(self.num_envs, None, dtype=object)
            for over in np.flatnonzero(done):
                final[over] = infos[over][_FINAL]
            found["final_obs"] = final
        return found


class RecordedVecEnv(VecEnvWrapper):  # type: ignore[misc]
    """A VecEnv that records another; gpusimbench.wrap makes it."""

    def __init__(self, recorded: Recorded) -> None:
        """Of a recorded AsGymnasium."""
        super().__init__(recorded.env.venv)
        self._recorded, self._inner = recorded, recorded.env
        self._given: list[int] | None = None  # seeds of the next reset
        self._actions: Any = None

    def seed(self, seed: int | None = None) -> Any:
        """Seeds of the next reset; None: drawn, and recorded as drawn."""
        given = super().seed(seed)
        self._given = list(given)
        return given

    def reset(self) -> Any:
        """See VecEnv.reset."""
        seeds, self._given = self._given, None
        in_order = seeds is not None and seeds == list(range(seeds[0], seeds[0] + len(seeds)))
        self._recorded.reset(seed=seeds[0] if seeds is not None and in_order else seeds)
        return self._inner.told

    def step_async(self, actions: Any) -> None:
        """See VecEnv.step_async. The step is made by step_wait, since its actions are recorded before it."""
        self._actions = actions

    def step_wait(self) -> Any:
        """See VecEnv.step_wait."""
        self._recorded.step(self._actions)
        return self._inner.told

    def fingerprint(self, name: str, arrays: Any) -> None:
        """Hash arrays of an update, such as a policy, a gradient or a batch; see Recorded.fingerprint."""
        self._recorded.fingerprint(name, arrays)

    def close(self) -> None:
        """See VecEnv.close. A recording of fewer steps than were asked for ends as failed, and says so."""
        self._recorded.close()

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        """Close the environment, and end the recording; an error is its reason."""
        self._recorded.__exit__(kind, error, trace)
