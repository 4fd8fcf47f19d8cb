"""Scenes whose parameters differ from environment to environment: factors of masses, frictions and sizes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Inertial, Link, Material, Plane, Robot, Scene, Sphere


@dataclass(frozen=True)
class Factors:
    """The factors of one quantity.

    items   names of what it is of, as `varied_items` gives them
    values  by which the scene's parameters are multiplied, shape [env, item]
    """

    items: tuple[str, ...]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class Variation:
    """The parameters of each environment, as factors of the scene's.

    factors  by quantity, of schemas.treatment.QUANTITIES
    """

    factors: Mapping[str, Factors]

    def of(self, scene: Scene, env: int) -> Scene:
        """The scene as it is in one environment: what this environment, simulated alone, would be described by.

        A mass scales the moments of inertia with it. A size scales the shape about its centre, which stays where it is;
        the mass stays, too.
        """
        by_quantity = {
            quantity: dict(zip(found.items, found.values[env].tolist(), strict=True))
            for quantity, found in self.factors.items()
        }
        mass, friction, size = (by_quantity.get(name, {}) for name in ("mass", "friction", "size"))
        bodies = tuple(_body(body, mass, friction, size) for body in scene.bodies)
        robot = scene.robot
        if robot is not None:
            links = tuple(_link(link, mass.get(link.name, 1.0)) for link in robot.links)
            robot = replace(robot, links=links, material=_material(robot.material, friction.get(robot.name, 1.0)))
        return replace(scene, bodies=bodies, robot=robot)

    def alike(self, env: int) -> Variation:
        """The same, with the parameters of one environment in all of them."""
        return Variation(
            {
                quantity: replace(found, values=np.repeat(found.values[env : env + 1], len(found.values), axis=0))
                for quantity, found in self.factors.items()
            }
        )


def varied_items(scene: Scene, quantity: str) -> tuple[str, ...]:
    """What of a scene has a factor of a quantity: the moving bodies in order, then of its robot each link that moves
    (mass) or the robot, which has one material (friction); a robot's size does not vary."""
    bodies = tuple(body.name for body in scene.moving())
    if scene.robot is None or quantity == "size":
        return bodies
    return bodies + ((scene.robot.name,) if quantity == "friction" else _moving_links(scene.robot))


def _moving_links(robot: Robot) -> tuple[str, ...]:
    moving: set[str] = set()
    for link in robot.links:  # parents come first
        if link.joint is not None or link.parent in moving:
            moving.add(link.name)
    return tuple(link.name for link in robot.links if link.name in moving)


def _body(body: Body, mass: dict[str, float], friction: dict[str, float], size: dict[str, float]) -> Body:
    if body.mass is None:
        return body
    factor = size.get(body.name, 1.0)
    shape = body.shape
    match shape:
        case Box((x, y, z)):
            shape = Box((x * factor, y * factor, z * factor))
        case Sphere(radius):
            shape = Sphere(radius * factor)
        case Capsule(radius, length):
            shape = Capsule(radius * factor, length * factor)
        case Plane():
            pass
    material = _material(body.material, friction.get(body.name, 1.0))
    return replace(body, mass=body.mass * mass.get(body.name, 1.0), shape=shape, material=material)


def _material(material: Material, factor: float) -> Material:
    static, kinetic = material.static_friction * factor, material.kinetic_friction * factor
    return replace(material, static_friction=static, kinetic_friction=kinetic)


def _link(link: Link, factor: float) -> Link:
    was = link.inertial
    xx, yy, zz, xy, xz, yz = (factor * moment for moment in was.inertia)
    return replace(link, inertial=Inertial(factor * was.mass, was.centre, (xx, yy, zz, xy, xz, yz)))
