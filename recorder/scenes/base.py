"""Engine-neutral scene descriptions: SI units, world frame with z up, quaternions wxyz.

A scene is data. An adapter translates it (``recorder.scenes.emit``) and reports every parameter that its engine has no
counterpart for; nothing is dropped in silence.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gpusimbench.recorder.scenes.actions import JointTargets
    from gpusimbench.recorder.scenes.articulation import Robot

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Box:
    """A box centred on its body.

    size  full edge lengths along x, y, z [m]
    """

    size: Vector


@dataclass(frozen=True)
class Sphere:
    """A sphere centred on its body.

    radius  [m]
    """

    radius: float


@dataclass(frozen=True)
class Capsule:
    """A cylinder along z with hemispherical ends, centred on its body.

    radius  [m]
    length  of the cylinder, between the hemispheres' centres [m]
    """

    radius: float
    length: float


@dataclass(frozen=True)
class Plane:
    """The half-space below z = 0 of its body; for fixed bodies only."""


Shape = Box | Sphere | Capsule | Plane


@dataclass(frozen=True)
class Material:
    """Contact parameters of a surface, dimensionless.

    static_friction   Coulomb coefficient at rest
    kinetic_friction  Coulomb coefficient while sliding
    restitution       ratio of normal speeds after and before an impact
    """

    name: str
    static_friction: float
    kinetic_friction: float
    restitution: float


@dataclass(frozen=True)
class Body:
    """A rigid body of one shape, with its centre of mass at its centre.

    mass              [kg]; None for a body that never moves
    group             bodies that are recorded together; empty for fixed bodies
    position          of the centre [m]
    orientation       unit quaternion wxyz
    linear_velocity   of the centre [m/s]
    angular_velocity  in the world frame [rad/s]
    """

    name: str
    shape: Shape
    material: Material
    position: Vector
    mass: float | None = None
    group: str = ""
    orientation: Quaternion = IDENTITY
    linear_velocity: Vector = (0.0, 0.0, 0.0)
    angular_velocity: Vector = (0.0, 0.0, 0.0)

    @property
    def fixed(self) -> bool:
        """Whether the body is part of the world."""
        return self.mass is None


@dataclass(frozen=True)
class Scene:
    """One environment.

    bodies       in recording order; moving bodies belong to a group
    robot        None where there is none; recorded as group "robot", joint by joint
    actions      what is applied at each step; None where nothing is
    gravity      [m/s2]
    dt           the protocol's step [s]
    sample_time  when the outcome is read [s]
    board        the fixed box that moving bodies should stay on, or empty where there is none
    summary      one sentence for lists
    """

    name: str
    summary: str
    bodies: tuple[Body, ...]
    robot: Robot | None = None
    actions: JointTargets | None = None
    gravity: Vector = (0.0, 0.0, -9.81)
    dt: float = 0.01
    sample_time: float = 5.0
    board: str = ""
    parameters: dict[str, Any] = field(default_factory=dict)

    def moving(self) -> tuple[Body, ...]:
        """Bodies that move, in order."""
        return tuple(body for body in self.bodies if not body.fixed)

    def groups(self) -> dict[str, tuple[str, ...]]:
        """Names of the moving bodies by group, groups in order of first appearance."""
        groups: dict[str, list[str]] = {}
        for body in self.moving():
            groups.setdefault(body.group, []).append(body.name)
        return {group: tuple(names) for group, names in groups.items()}

    def to_json(self) -> str:
        """As the text that a recording carries; shapes are tagged with their kind."""
        return json.dumps(_plain(self), indent=1, sort_keys=True) + "\n"

    def sha256(self) -> str:
        """Identity of the description [hex]."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Dataclasses as dictionaries, shapes tagged with their kind, what is absent left out."""
    if is_dataclass(value):
        record = {f.name: _plain(getattr(value, f.name)) for f in fields(value)}
        if isinstance(value, Shape):
            record["kind"] = type(value).__name__.lower()
        return {name: item for name, item in record.items() if item is not None}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value
