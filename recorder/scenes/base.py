"""Engine-neutral scene descriptions: SI units, world frame with z up, quaternions wxyz.

A scene is data. An adapter translates it (``recorder.scenes.emit``) and reports every parameter that its engine has no
counterpart for; nothing is dropped in silence.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.scenes.loop import FourBar, Loop
from gpusimbench.schemas.action_generator import JointTargets

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)

_LEVEL = 1e-12  # sine of the tilt below which a plane counts as level


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


def solid_inertia(shape: Shape, mass: float) -> Vector:
    """Principal moments of a uniform solid about its centre, along its axes [kg m2].

    A capsule is a cylinder and two hemispheres, whose centres of mass are 3/8 of a radius beyond its ends; see any
    table of moments of inertia. ValueError for a plane.
    """
    match shape:
        case Box((x, y, z)):
            return mass * (y * y + z * z) / 12, mass * (x * x + z * z) / 12, mass * (x * x + y * y) / 12
        case Sphere(radius):
            return (0.4 * mass * radius**2,) * 3
        case Capsule(radius, length):
            cylinder = mass * length / (length + 4 / 3 * radius)
            ends = mass - cylinder
            along = cylinder * radius**2 / 2 + ends * 0.4 * radius**2
            across = cylinder * (length**2 / 12 + radius**2 / 4)
            across += ends * (0.4 * radius**2 + length**2 / 4 + 3 / 8 * radius * length)
            return across, across, along
    raise ValueError("a plane has no inertia")


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
    launch            direction along which --initial draws the velocity, a unit vector of the world frame, or zero
                      where it draws none; None: along all axes
    spin              share of the spread of --initial, read in rad/s, within which each component of the angular
                      velocity is drawn, in the world frame; None: it is not drawn
    turned            whether --initial draws the orientation, uniformly over all rotations; None: it does not
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
    launch: Vector | None = None
    spin: Vector | None = None
    turned: bool | None = None

    @property
    def fixed(self) -> bool:
        """Whether the body is part of the world."""
        return self.mass is None


@dataclass(frozen=True)
class Placed:
    """A shape at a pose in its link's frame.

    position     of the shape's centre [m]
    orientation  unit quaternion wxyz
    """

    shape: Shape
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Quaternion = IDENTITY


@dataclass(frozen=True)
class Inertial:
    """Mass properties of a link, in the axes of its frame.

    mass     [kg]
    centre   of mass [m]
    inertia  about the centre of mass: xx, yy, zz, xy, xz, yz [kg m2]
    """

    mass: float
    centre: Vector
    inertia: tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Hinge:
    """A joint about the z axis of its link's frame, moved by a position servo.

    lower, upper   limits [rad]
    max_velocity   as published [rad/s]; engines do not enforce it
    max_torque     of the servo [N m]
    stiffness      of the servo [N m/rad]
    damping        of the servo [N m s/rad]
    friction       viscous, of the joint itself [N m s/rad]
    armature       inertia of the motor as seen at the joint [kg m2]
    """

    name: str
    lower: float
    upper: float
    max_velocity: float
    max_torque: float
    stiffness: float
    damping: float
    friction: float
    armature: float


@dataclass(frozen=True)
class Link:
    """A rigid part of a robot.

    parent       name of the link it hangs on, empty for the base
    position     of its frame in the parent's [m], at joint angle zero
    orientation  the same, unit quaternion wxyz
    joint        None where it is rigidly attached
    """

    name: str
    parent: str
    position: Vector
    orientation: Quaternion
    inertial: Inertial
    shapes: tuple[Placed, ...] = ()
    joint: Hinge | None = None


@dataclass(frozen=True)
class Robot:
    """A robot on a fixed base at the world's origin: a tree of links on hinges.

    links     parents before children
    start     initial joint angles [rad], in the order of the joints
    apart     pairs of links that never collide though they are not parent and child: their shapes overlap by design
    drawn     share of the spread of --initial within which each joint's angle is drawn; None: all of it
    loop      the pin that makes a loop of its links; None where they are a tree alone
    """

    name: str
    links: tuple[Link, ...]
    start: tuple[float, ...]
    material: Material
    apart: tuple[tuple[str, str], ...] = ()
    drawn: tuple[float, ...] | None = None
    loop: Loop | None = None

    def four_bar(self) -> FourBar | None:
        """The lengths of its loop; None where it has none."""
        if self.loop is None:
            return None
        links = {link.name: link for link in self.links}
        coupler, rocker = links[self.loop.coupler], links[self.loop.rocker]
        ground = rocker.position[0] - links[coupler.parent].position[0]
        return FourBar(ground, coupler.position[0], self.loop.on_coupler[0], self.loop.on_rocker[0])

    def speeds(self) -> tuple[float, ...]:
        """Initial joint speeds [rad/s], in the order of the joints."""
        lengths = self.four_bar()
        if self.loop is None or lengths is None:
            return (0.0,) * len(self.start)
        return tuple(lengths.speeds(np.array(self.start), self.loop.speed).tolist())

    def branches(self) -> bool:
        """Whether its joints are not in the order of their distance from the base, since chains stand one by one.

        Engines have joints in one order or the other.
        """
        depth = {"": 0}
        for link in self.links:
            depth[link.name] = depth[link.parent] + 1
        depths = [depth[link.name] for link in self.links if link.joint is not None]
        return depths != sorted(depths)

    def joints(self) -> tuple[Hinge, ...]:
        """The joints in order: the order of qpos, qvel and actions."""
        return tuple(link.joint for link in self.links if link.joint is not None)


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
    tosses       True where environments begin as measured tosses (recorder.trials.tosses); None where not
    summary      one sentence for lists
    """

    own_options: ClassVar[frozenset[str]] = frozenset()
    """Names of options that the scene takes itself, beside those of the simulator."""

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
    tosses: bool | None = None

    def moving(self) -> tuple[Body, ...]:
        """Bodies that move, in order."""
        return tuple(body for body in self.bodies if not body.fixed)

    def groups(self) -> dict[str, tuple[str, ...]]:
        """Names of the moving bodies by group, groups in order of first appearance."""
        groups: dict[str, list[str]] = {}
        for body in self.moving():
            groups.setdefault(body.group, []).append(body.name)
        return {group: tuple(names) for group, names in groups.items()}

    def needs(self) -> frozenset[Ability]:
        """What an engine has to be able to do to simulate this scene; a scene that needs more overrides it."""
        needs = {_ability_for(body) for body in self.bodies}
        if self.moving():
            needs.add(Ability.FREE_BODIES)
        if self.robot is not None:
            needs.add(Ability.FIXED_BASE)
            if self.robot.joints():
                needs.add(Ability.HINGES)
            if self.robot.branches():
                needs.add(Ability.CHAINS)
            if self.robot.loop is not None:
                needs.add(Ability.LOOPS)
            if self.moving():
                needs.add(Ability.ROBOT_AMONG_BODIES)
        if self.actions is not None:
            needs.add(Ability.ACTIONS)
        if self.tosses:
            needs.add(Ability.ENV_STARTS)
        return frozenset(needs)

    def timed_window(self) -> tuple[int, int]:
        """Steps before the timed ones, and the timed ones, where nobody says otherwise: the window of the protocol.

        Half of the cubes of a toss are at rest after 100 steps.
        """
        return (10, 100) if self.tosses else (100, 1000)

    def options(self, given: Mapping[str, str], known: Collection[str]) -> Mapping[str, str]:
        """Options of a simulator as text: those that the user gave, and what else the scene has to say.

        known  names of all options of the simulator

        UsageError for an option that does not go with the scene.
        """
        return given

    def with_options(self, given: Mapping[str, str]) -> Self:
        """The scene with those of the given options that are its own; UsageError for a value that cannot be."""
        return self

    def joint_limits(self) -> dict[str, tuple[tuple[float, float], ...]]:
        """Lower and upper limits of joints [rad or m], by group of the state and in its order."""
        if self.robot is None:
            return {}
        return {"robot": tuple((joint.lower, joint.upper) for joint in self.robot.joints())}

    def to_json(self) -> str:
        """As the text that a recording carries; shapes are tagged with their kind."""
        return self._text

    @cached_property
    def _text(self) -> str:  # a run asks for it twice: as an attachment, and for its hash
        return json.dumps(_plain(self), indent=1, sort_keys=True) + "\n"

    def sha256(self) -> str:
        """Identity of the description [hex]."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()


def _ability_for(body: Body) -> Ability:
    match body.shape:
        case Box():
            return Ability.BOXES
        case Sphere():
            return Ability.SPHERES
        case Capsule():
            return Ability.CAPSULES
        case Plane():
            w, x, y, z = body.orientation
            sine = math.hypot(2 * (x * z + w * y), 2 * (y * z - w * x))  # of the angle between its normal and z
            return Ability.PLANES if sine < _LEVEL else Ability.TILTED_PLANES


def _plain(value: Any) -> Any:
    """Dataclasses as dictionaries, shapes tagged with their kind, what is absent left out."""
    if is_dataclass(value):
        described = [f.name for f in fields(value) if f.metadata.get("described", True)]
        record = {name: _plain(getattr(value, name)) for name in described}
        if isinstance(value, Shape):
            record["kind"] = type(value).__name__.lower()
        return {name: item for name, item in record.items() if item is not None}
    if isinstance(value, (tuple, list)):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return value
