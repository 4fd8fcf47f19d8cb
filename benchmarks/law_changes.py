"""Changes of an engine's parameters, each of the size that a law in closed form claims to notice.

The engine is given another scene than the recording declares (friction, restitution, gravity, damping of joints). What
no scene says (moments of inertia, angular damping, centres of mass) is changed in the model that MuJoCo C has built.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from gpusimbench import Scene
from gpusimbench.recorder.scenes.base import IDENTITY, Body, Link

WHOLE = frozenset({"gravity", "restitution"})
"""Parameters that a scene has once, so that one recording has one change of them; restitution is that of all surfaces,
so that no rule of combining them matters."""

POSITIVE = frozenset({"damping", "angular damping"})
"""Parameters that are zero in the scene and never negative."""

BUILT = frozenset({"middle moment", "angular damping", "centre of mass"})
"""Parameters that no scene says, in the model of MuJoCo C alone."""


@dataclass(frozen=True)
class Change:
    """Of one parameter.

    parameter  as of LawValues.slopes
    subject    name of the body, of the lane, or of the pendulum whose joints begin so; not looked at for WHOLE, nor for
               "centre of mass", which is that of every body that moves
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
        alone = len(robot.joints()) == 1
        robot = replace(robot, links=tuple(_link(link, changes, alone=alone) for link in robot.links))
    bodies = tuple(_body(body, changes) for body in scene.bodies)
    return replace(scene, gravity=(x * down, y * down, z * down), bodies=bodies, robot=robot)


def _body(body: Body, changes: Sequence[Change]) -> Body:
    friction = bounce = 1.0
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
    return replace(body, material=material)


def _link(link: Link, changes: Sequence[Change], *, alone: bool) -> Link:
    if link.joint is None:
        return link
    added = sum(
        one.size for one in changes
        if one.parameter == "damping" and (alone or link.name.startswith(f"{one.subject}_"))
    )  # fmt: skip
    return replace(link, joint=replace(link.joint, friction=link.joint.friction + added))


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
