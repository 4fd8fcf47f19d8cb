"""The scene of a recording as mechanics needs it: masses, shapes, what never moves, what is down."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.solids import Fixed, FixedBox, HalfSpace, rotations
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, damage_in

Array = npt.NDArray[np.float64]

_LARGE = 1e6  # metres, kilograms: no scene of a robot simulator has more
_SMALL = 1e-9
_CUBIC = 1e-9  # edges that differ by less belong to a cube


@dataclass(frozen=True)
class Surface:
    """Coefficients of a material: kinetic and static friction, restitution."""

    kinetic: float
    static: float
    restitution: float


@dataclass(frozen=True)
class Moving:
    """A body that moves.

    radius  of a ball [m]; 0 for a cube
    half    half an edge of a cube [m]; 0 for a ball
    start   of its centre [m]
    rests   whether it starts without velocity
    """

    name: str
    mass: float
    radius: float
    half: float
    start: tuple[float, ...]
    rests: bool
    surface: Surface

    @property
    def inertia(self) -> float:
        """About any axis through the centre [kg m2]: 2/5 m r^2 of a solid ball, m edge^2 / 6 of a cube."""
        return self.mass * (0.4 * self.radius**2 + 2.0 / 3.0 * self.half**2)

    @property
    def reach(self) -> float:
        """The distance from the centre to the farthest point [m]."""
        return self.radius + self.half * math.sqrt(3.0)


@dataclass(frozen=True)
class FixedBody:
    """A body that never moves; `level` where its upper face is horizontal."""

    solid: Fixed
    surface: Surface
    level: bool

    @property
    def top(self) -> float:
        """Height of a level body's upper face [m]."""
        if isinstance(self.solid, FixedBox):
            return float(self.solid.centre[2] + self.solid.half[2])
        return float(self.solid.point[2])


@dataclass(frozen=True)
class World:
    """A scene of balls and cubes.

    moving   in the order of the recorded groups and items
    fixed    in the scene's order
    gravity  magnitude, along -z [m/s2]
    rebounds whether the coefficients of restitution are known; a scene that says of its parameter "restitution_known"
             that it is false leaves them to each engine
    """

    moving: tuple[Moving, ...]
    fixed: tuple[FixedBody, ...]
    gravity: float
    rebounds: bool = True

    @property
    def restitution(self) -> float:
        """The largest coefficient of any material; 1, the most that mechanics allows, where it is not known."""
        if not self.rebounds:
            return 1.0
        surfaces = [*(body.surface for body in self.moving), *(body.surface for body in self.fixed)]
        return max(surface.restitution for surface in surfaces)

    @property
    def mass(self) -> Array:
        """The masses of the moving bodies [kg]."""
        return np.array([body.mass for body in self.moving])

    @property
    def floors(self) -> tuple[FixedBody, ...]:
        """The fixed bodies that are level."""
        return tuple(body for body in self.fixed if body.level)


def world_of(recording: Recording, items: Sequence[tuple[str, str]]) -> World | Missing:
    """The world of a recording, or the reason why mechanics has nothing to say of it.

    items  group and name of each recorded body, in order

    Raises DamagedRecording where the scene is unreadable.
    """
    with damage_in(recording.path):
        scene = recording.scene
        if "gravity" not in scene or "bodies" not in scene:
            return Missing("the recording has no scene with gravity and bodies")
        x, y, z = checks.vector(scene.get("gravity"), 3, "gravity")
        if x or y or not -_LARGE < z < 0:
            return Missing("gravity is not along -z")
        described = {(checks.text(b, "group", ""), checks.text(b, "name")): b for b in checks.objects(scene, "bodies")}
        moving = []
        for key in items:
            body = described.get(key)
            if body is None or body.get("mass") is None:
                return Missing(f"the scene does not describe {key[1]}")
            mover = _moving(key[1], body)
            if isinstance(mover, Missing):
                return mover
            moving.append(mover)
        fixed = []
        for (_, name), body in described.items():
            if body.get("mass") is None:
                made = _fixed(name, body)
                if isinstance(made, Missing):
                    return made
                fixed.append(made)
        parameters = checks.mapping(scene, "parameters") if "parameters" in scene else {}
        rebounds = parameters.get("restitution_known") is not False
        return World(tuple(moving), tuple(fixed), -z, rebounds)


def _moving(name: str, body: dict[str, Any]) -> Moving | Missing:
    shape = checks.mapping(body, "shape")
    radius = half = 0.0
    if shape.get("kind") == "sphere":
        radius = checks.number(shape, "radius", _SMALL, _LARGE)
    elif shape.get("kind") == "box":
        size = _size(shape)
        if max(size) - min(size) > _CUBIC:
            return Missing(f"{name} is a box of unequal edges: only balls and cubes are looked at")
        half = size[0] / 2.0
    else:
        return Missing(f"{name} is neither a ball nor a cube")
    still = [checks.vector(body.get(field, [0.0] * 3), 3, field) for field in ("linear_velocity", "angular_velocity")]
    return Moving(
        name,
        checks.number(body, "mass", _SMALL, _LARGE),
        radius,
        half,
        _bounded(body.get("position"), 3, "a body's position"),
        not any(any(velocity) for velocity in still),
        _surface(body),
    )


def _fixed(name: str, body: dict[str, Any]) -> FixedBody | Missing:
    shape = checks.mapping(body, "shape")
    centre = np.array(_bounded(body.get("position"), 3, "a body's position"))
    quaternion = np.array(_bounded(body.get("orientation", [1.0, 0.0, 0.0, 0.0]), 4, "a body's orientation"))
    rotation = rotations(quaternion)
    level = bool(rotation[2, 2] == 1.0)
    if shape.get("kind") == "plane":
        return FixedBody(HalfSpace(centre, rotation[:, 2]), _surface(body), level)
    if shape.get("kind") == "box":
        return FixedBody(FixedBox(centre, rotation, np.array(_size(shape)) / 2.0), _surface(body), level)
    return Missing(f"{name} is fixed, and neither a plane nor a box")


def _bounded(value: Any, size: int, what: str) -> tuple[float, ...]:
    found = checks.vector(value, size, what)
    if max(map(abs, found)) > _LARGE:
        raise DamagedRecording(f"{what} is beyond {_LARGE:g}")
    return found


def _size(shape: dict[str, Any]) -> tuple[float, ...]:
    size = checks.vector(shape.get("size"), 3, "a box's size")
    if not all(_SMALL <= edge <= _LARGE for edge in size):
        raise DamagedRecording("a box's size is not that of any box")
    return size


def _surface(body: dict[str, Any]) -> Surface:
    material = checks.mapping(body, "material")
    names = ("kinetic_friction", "static_friction", "restitution")
    kinetic, static, restitution = (checks.number(material, name, 0.0, _LARGE) for name in names)
    return Surface(kinetic, static, restitution)
