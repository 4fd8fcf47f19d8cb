"""Where the environments of one PhysX scene stand."""

from __future__ import annotations

import math

from gpusimbench.recorder.scenes.base import Plane, Scene, Vector
from gpusimbench.recorder.simulators.snapshot import Envs


def origins(n_env: int, spacing: float) -> tuple[Vector, ...]:
    """Origin of each environment [m]: on a square grid, numbered square by square, so that they do not depend on how
    many there are. Empty where the spacing is 0."""
    return tuple((spacing * x, spacing * y, 0.0) for x, y in map(_cell, range(n_env))) if spacing else ()


def every(n_env: int, envs: Envs) -> range | list[int]:
    """The environments that are meant."""
    return range(n_env) if envs is None else [int(env) for env in envs]


def _cell(env: int) -> tuple[int, int]:
    # the first n * n fill a square: cell (n, 0) .. (n, n) and then (n - 1, n) .. (0, n) make the next one
    side = math.isqrt(env)
    rest = env - side * side
    return (side, rest) if rest <= side else (2 * side - rest, side)


def shared_bodies(scene: Scene, spacing: float) -> tuple[str, ...]:
    """Names of the fixed bodies of which one serves all environments: all of them where the spacing is 0, else planes.

    A plane has no edge: every environment would meet those of all others.
    """
    fixed = [body for body in scene.bodies if body.fixed]
    if not spacing:
        return tuple(body.name for body in fixed)
    return tuple(body.name for body in fixed if isinstance(body.shape, Plane))
