"""States of MuJoCo in the tasks of a vector environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.vector import PHYSICS

NAMES = ("qpos", "qvel")


class Physics:
    """The data of all tasks; UsageError where they are no MuJoCo tasks of Gymnasium, or live in other processes."""

    def __init__(self, envs: Any) -> None:
        tasks = [one.unwrapped for one in getattr(envs.unwrapped, "envs", ())]
        if not tasks or not all(hasattr(getattr(task, "data", None), name) for task in tasks for name in NAMES):
            raise UsageError("physics is recorded of Gymnasium's MuJoCo tasks in a SyncVectorEnv")
        self._tasks = tasks

    def states(self) -> dict[str, NDArray[np.float64]]:
        """The present states, [env, ...], by the names of their arrays."""
        return {f"{PHYSICS}{name}": np.stack([getattr(task.data, name) for task in self._tasks]) for name in NAMES}
