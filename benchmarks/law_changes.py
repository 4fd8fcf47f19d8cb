"""Changes of an engine's parameters, each of the size that a law in closed form claims to notice.

The engine is given another scene than the recording declares (friction, restitution, gravity, damping of joints, masses
of links and lengths of those that close a loop). What no scene says (moments of inertia, angular damping, centres of
mass) is changed in the model that MuJoCo C has built.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from gpusimbench import Scene
from gpusimbench.recorder.scenes.base import IDENTITY, Body, Link, Robot

WHOLE = frozenset({"gravity", "restitution"})
"""Parameters that a scene has once, so that one recording has one change of them; restitution is that of all surfaces,
so that no rule of combining them matters."""

POSITIVE = frozenset({"damping", "angular damping"})
"""Parameters that are zero in the scene and never negative."""

EVERY_MASS = "every mass"
"""A parameter of no law: all masses at once, whose ratios stay."""

BUILT = frozenset({"middle moment", "angular damping", "centre of mass"})
"""Parameters that no scene says, in the model of MuJoCo C alone."""


@dataclass(frozen=True)
class Change:
    """Of one parameter.

    parameter  as of LawValues.slopes
    subject    name of the body, of the lane, or of the pendulum whose joints begin so; not looked at for WHOLE, nor for
               "centre of mass", which is that of every body that moves, nor for the damping of a robot that is one
               mechanism, nor for EVERY_MASS and parameters that name a link
    size       what is added: a share of the parameter, N m s/rad of a joint, 1/s of a body's angular damping, or metres
               by which the centre of mass is moved toward +z of the body
    """

    parameter: str
    subject: str
    size: float


def changed_scene(scene: Scene, changes: Sequence[Change]) -> Scene:
    """The scene with those changes that a scene can have."""
    down = 1.0 + sum(one.size for one in changes if one.parameter == "gravity")
    x, y, z = scene.gravity
    robot = scene.robot
    if robot is not None:
        alone = len(robot.joints()) == 1 or robot.loop is not None
        robot = replace(robot, links=tuple(_link(link, changes, alone=alone) for link in robot.links))
        robot = _closed(robot, changes)
    bodies = tuple(_body(body, changes) for body in scene.bodies)
    return replace(scene, gravity=(x * down, y * down, z * down), bodies=bodies, robot=robot)


def _body(body: Body, changes: Sequence[Change]) -> Body:
    friction = bounce = 1.0
    heavier = 1.0 + sum(one.size for one in changes if one.parameter == EVERY_MASS)
    for one in changes:
        if one.parameter == "restitution":
            bounce += one.size
        elif one.parameter == "friction" and body.name in (one.subject, f"plank-{one.subject}"):
            friction += one.size
    material = replace(
        body.material,
        static_friction=body.material.static_friction * friction,
        kinetic_friction=body.material.kinetic_friction * friction,
        restitution=body.material.restitution * bounce,
    )
    return replace(body, material=material, mass=None if body.mass is None else body.mass * heavier)


def _link(link: Link, changes: Sequence[Change], *, alone: bool) -> Link:
    factor = 1.0 + sum(one.size for one in changes if one.parameter in (f"{link.name}'s mass", EVERY_MASS))
    if factor != 1.0:
        was = link.inertial
        xx, yy, zz, xy, xz, yz = (factor * moment for moment in was.inertia)
        link = replace(link, inertial=replace(was, mass=was.mass * factor, inertia=(xx, yy, zz, xy, xz, yz)))
    if link.joint is None:
        return link
    added = sum(
        one.size for one in changes
        if one.parameter == "damping" and (alone or link.name.startswith(f"{one.subject}_"))
    )  # fmt: skip
    return replace(link, joint=replace(link.joint, friction=link.joint.friction + added))


def _closed(robot: Robot, changes: Sequence[Change]) -> Robot:
    """The robot with the pin of its loop farther along coupler and rocker, whose masses stay where they are, at angles
    that close this loop."""
    if robot.loop is None:
        return robot
    on_coupler, on_rocker = (
        (along * (1.0 + sum(one.size for one in changes if one.parameter == f"{link}'s length")), y, z)
        for link, (along, y, z) in (
            (robot.loop.coupler, robot.loop.on_coupler),
            (robot.loop.rocker, robot.loop.on_rocker),
        )
    )
    if (on_coupler, on_rocker) == (robot.loop.on_coupler, robot.loop.on_rocker):
        return robot
    longer = replace(robot, loop=replace(robot.loop, on_coupler=on_coupler, on_rocker=on_rocker))
    linkage = longer.four_bar()
    assert linkage is not None  # there is a loop
    return replace(longer, start=tuple(linkage.angles(robot.start[0]).tolist()))


def change_model(model: Any, changes: Sequence[Change]) -> None:
    """Make the other changes, in a mujoco.MjModel that is not stepped yet.

    An angular damping c turns the angular momentum L by the torque -c L, and so takes 2 c of the energy: in MuJoCo, a
    damping c I of each rotation of a free joint, about the axes of the body, which are the principal ones of a box.
    """
    for one in changes:
        if one.parameter not in BUILT:
            continue
        if one.parameter == "centre of mass":
            _shift(model, one.size)
            continue
        body = int(model.body(one.subject).id)
        if not np.array_equal(model.body_iquat[body], IDENTITY):
            raise ValueError(f"the principal axes of {one.subject} are not those of its frame")
        moments = model.body_inertia[body]
        if one.parameter == "middle moment":
            moments[int(np.argsort(moments)[1])] *= 1.0 + one.size
        else:
            first = int(model.body_dofadr[body]) + 3
            model.dof_damping[first : first + 3] = one.size * moments
    mujoco.mj_setConst(model, mujoco.MjData(model))  # the masses of simple joints are computed once


def _shift(model: Any, by: float) -> None:
    """Move shapes down instead of centres of mass up: MuJoCo's shortcuts for bodies whose frame is the inertial one are
    compiled into the model."""
    for geom in range(model.ngeom):
        if model.body_dofnum[model.geom_bodyid[geom]]:
            model.geom_pos[geom, 2] -= by
            model.geom_sameframe[geom] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
