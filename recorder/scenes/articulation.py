"""Robots: trees of links on hinges, engine-neutral. SI units; a link's frame is its joint's, with the axis along z."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.recorder.scenes.base import IDENTITY, Material, Quaternion, Shape, Vector


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
    """A robot on a fixed base at the world's origin.

    links     parents before children
    start     initial joint angles [rad], in the order of the joints
    apart     pairs of links that never collide though they are not parent and child: their shapes overlap by design
    """

    name: str
    links: tuple[Link, ...]
    start: tuple[float, ...]
    material: Material
    apart: tuple[tuple[str, str], ...] = ()

    def joints(self) -> tuple[Hinge, ...]:
        """The joints in order: the order of qpos, qvel and actions."""
        return tuple(link.joint for link in self.links if link.joint is not None)
