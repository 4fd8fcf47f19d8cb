"""The scenes of environments whose parameters differ, compiled by MuJoCo one by one: what it derives from masses and
sizes, such as the inverse weights of constraints, is then derived by its own compiler for every engine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.variation import Variation
from gpusimbench.recorder.simulators.mujoco.model import compile_scene
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions


def compile_varied(
    scene: Scene,
    variation: Variation | None,
    *,
    n_env: int,
    dt: float,
    options: MjcfOptions,
    numerics: dict[str, str] | None = None,
) -> list[Any]:
    """A mujoco.MjModel for each environment, none where no parameter varies; arguments as of compile_scene."""
    if variation is None:
        return []
    scenes = (variation.of(scene, env) for env in range(n_env))
    return [compile_scene(one, dt=dt, options=options, numerics=numerics).model for one in scenes]


def varied_fields(model: Any, models: Sequence[Any]) -> dict[str, NDArray[Any]]:
    """The fields of MjModel in which any of some models differs from a model of the same structure: [env, ...]."""
    names = [name for name in dir(model) if not name.startswith("_") and isinstance(getattr(model, name), np.ndarray)]
    return {
        name: np.stack([getattr(other, name) for other in models])
        for name in names
        if any(not np.array_equal(getattr(model, name), getattr(other, name)) for other in models)
    }
