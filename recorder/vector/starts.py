"""Tasks that begin in a given state instead of that which reset draws: here, MuJoCo tasks of Gymnasium."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np

from gpusimbench.recorder.vector.origin import GivenEpisode, State
from gpusimbench.schemas.errors import UsageError


class Started(gymnasium.Wrapper):  # type: ignore[misc]
    """A task whose next reset ends in `start`, where that is given."""

    start: GivenEpisode | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """See Env.reset. UsageError where the task cannot be brought into the state."""
        observation, info = self.env.reset(seed=seed, options=options)
        start, self.start = self.start, None
        return (observation if start is None or start.state is None else self.begun(start.state)), info

    def begun(self, state: State) -> Any:
        """Bring the task into a state; returns its observation. UsageError as of reset."""
        task = self.unwrapped
        if not all(callable(getattr(task, name, None)) for name in ("set_state", "_get_obs")):
            raise UsageError(
                f"{type(task).__name__} has no set_state, so that no episode can begin in a recorded state"
            )
        shapes = {name: getattr(task.data, name).shape for name in ("qpos", "qvel")}
        if odd := [name for name, shape in shapes.items() if state[name].shape != shape]:
            raise UsageError(
                f"the recorded {odd[0]} has {state[odd[0]].size} numbers, and the task {shapes[odd[0]][0]}"
            )
        task.set_state(np.asarray(state["qpos"], np.float64), np.asarray(state["qvel"], np.float64))
        return task._get_obs()


def begin_at(envs: Any, starts: Mapping[int, GivenEpisode]) -> None:
    """Have the next reset of some environments end in a state; UsageError where that cannot be.

    starts  by the number of the environment
    """
    tasks = getattr(envs.unwrapped, "envs", ())
    for env, start in starts.items():
        if env >= len(tasks) or not hasattr(tasks[env], "start"):
            raise UsageError(
                "episodes begin in a recorded state only in tasks that --env names: of MuJoCo in Gymnasium, of "
                "ManiSkill, and of robosuite"
            )
        tasks[env].start = start
