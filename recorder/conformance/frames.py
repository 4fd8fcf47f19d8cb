"""Positions relative to the origins of their environments, and what float32 leaves of them far from zero."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.conformance.verdict import fail
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.flight import Watch
from gpusimbench.schemas.fields import StateField

FRAMES = ("world", "env")
"""Of positions: with the origin of the environment in them, or without."""

SUBSTEPS = 16
"""Substeps of a step, in each of which a position is rounded: PhysX's TGS has one for each iteration of positions."""

_SAME = 1e-4  # [m], beyond rounding: bodies that are displaced by one vector


def origins_of(description: Description, n_env: int) -> NDArray[np.float64]:
    """Origins of the environments [env, 3] [m]; zeros where none are recorded."""
    return np.array(description.env_origins, dtype=np.float64) if description.env_origins else np.zeros((n_env, 3))


def local(description: Description, field: StateField, array: NDArray[np.floating]) -> NDArray[np.floating]:
    """Positions [..., env, item, 3] relative to the origins of their environments [m]; no copy where they are so."""
    origins = np.array(description.env_origins, dtype=np.float64) if description.env_origins else None
    return Watch((field,), origins=origins).local(field, array)


def rounding(description: Description, n_env: int) -> NDArray[np.float64]:
    """The distance between neighbouring numbers at the largest coordinate of each origin [env] [m]; 0 at zero.

    Engines hold positions in the world's frame in the precision that the description gives: no place is told better.
    """
    largest = np.abs(origins_of(description, n_env)).max(axis=1)
    spacings = [np.spacing(largest.astype(f.dtype)) for f in description.fields if f.field == "position"]
    return np.where(largest > 0, np.max(spacings, axis=0, initial=0.0), 0.0)


def drift(description: Description, n_env: int, n_step: int) -> NDArray[np.float64]:
    """How far bodies of each env may go astray because their positions are rounded in every substep [env] [m]."""
    return rounding(description, n_env) / 2 * (n_step * SUBSTEPS + 1)


def expect_origins(description: Description, error: dict[str, NDArray[np.float64]]) -> None:
    """AssertionError where all bodies of an environment are displaced by one and the same vector: a wrong origin.

    error  by body: first position relative to the origin minus the scene's [env, 3] [m]
    """
    errors = np.array(list(error.values()))  # [body, env, 3]
    if len(errors) < 2 or not np.isfinite(errors).all():
        return
    middle, tolerance = errors.mean(axis=0), _SAME + 2 * rounding(description, errors.shape[1])
    together = np.abs(errors - middle).max(axis=(0, 2)) <= tolerance
    displaced = np.abs(middle).max(axis=1) > tolerance
    if not (wrong := np.flatnonzero(together & displaced)).size:
        return
    env = int(wrong[0])
    said = origins_of(description, errors.shape[1])[env]
    frames = {field.frame for field in description.fields if field.field == "position"}
    if frames == {"env"}:
        fail(
            f"all positions of env {env} are {_vector(middle[env])} m from the scene's; their frame is 'env', which "
            f"has no origin in it (env_origins: {_vector(said)}): subtract the origin, or declare frame 'world'"
        )
    fail(
        f"all positions of env {env} are {_vector(middle[env])} m from the scene's: env_origins say that its origin is "
        f"{_vector(said)}, and the bodies stand as if it were {_vector(said + middle[env])}"
    )


def _vector(values: NDArray[np.float64]) -> str:
    return f"({', '.join(f'{round(value, 4) + 0.0:.6g}' for value in values.tolist())})"
