"""States of MuJoCo in the tasks of a vector environment."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.vector import PHYSICS
from gpusimbench.schemas.view.geometry import GEOMETRY, MEDIA_TYPE

NAMES = ("qpos", "qvel")
_DRAWN = (
    "body_parentid",
    "body_pos",
    "body_quat",
    "jnt_type",
    "jnt_bodyid",
    "jnt_pos",
    "jnt_axis",
    "qpos0",
    "geom_type",
    "geom_bodyid",
    "geom_dataid",
    "geom_pos",
    "geom_quat",
    "geom_size",
    "mesh_vert",
)
"""Arrays of a model by which one that is drawn is told from another."""


class Physics:
    """The data of all tasks; UsageError where they are no MuJoCo tasks of Gymnasium, or live in other processes."""

    def __init__(self, envs: Any) -> None:
        tasks = [one.unwrapped for one in getattr(envs.unwrapped, "envs", ())]
        if not tasks or not all(hasattr(getattr(task, "data", None), name) for task in tasks for name in NAMES):
            raise UsageError("physics is recorded of Gymnasium's MuJoCo tasks in a SyncVectorEnv")
        self._tasks = tasks

    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """What the bodies look like, for viewers, where all tasks have one model; see geometry_of."""
        from gpusimbench.recorder.simulators.mujoco.geometry import geometry_of

        models = [task.model for task in self._tasks if hasattr(task, "model")]
        if len(models) < len(self._tasks) or any(not _alike(models[0], other) for other in models[1:]):
            return {}
        return {GEOMETRY: (MEDIA_TYPE, geometry_of(models[0]))}

    def states(self) -> dict[str, NDArray[np.float64]]:
        """The present states, [env, ...], by the names of their arrays."""
        return {f"{PHYSICS}{name}": np.stack([getattr(task.data, name) for task in self._tasks]) for name in NAMES}


def _alike(one: Any, other: Any) -> bool:
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in _DRAWN)
