"""A four-bar linkage without friction: a crank that turns, a coupler, and a rocker that swings, closed by a pin.

The linkage lies level, so that gravity does no work; nothing touches anything and no motor acts. The crank is the
shortest link, and with the longest, the ground, it is shorter than the other two together, so that it turns all the way
round (Grashof). With `--initial random:SPREAD` every environment begins with its own angle and speed of the crank, and
with the loop closed.
"""

from __future__ import annotations

import math

from gpusimbench.recorder.scenes.base import (  # fmt: skip
    IDENTITY,
    Box,
    Capsule,
    Hinge,
    Inertial,
    Link,
    Material,
    Placed,
    Quaternion,
    Robot,
    Scene,
    Vector,
    solid_inertia,
)
from gpusimbench.recorder.scenes.loop import FourBar, Loop

LENGTHS = FourBar(ground=0.6, crank=0.2, coupler=0.5, rocker=0.4)
MASS = {"crank": 0.5, "coupler": 1.0, "rocker": 0.8}
START = 3.8  # of the crank [rad], where it is fast: a heavier rocker changes the period most near here
SPEED = 5.0  # of the crank [rad/s]
_ABOVE = 0.05  # of the coupler over crank and rocker [m], so that rods pass each other
_LIMIT = 1000.0  # far beyond what the crank turns

_RADIUS = 0.02
_HALF = math.sqrt(0.5)
_ALONG: Quaternion = (_HALF, 0.0, _HALF, 0.0)  # takes the axis of a capsule to the link's x axis


def four_bar() -> Scene:
    """The scene; at angle 0 crank and rocker point along the ground, from the crank's axis to the rocker's."""
    stand = Link(
        "stand",
        "",
        (0.0, 0.0, 1.0),
        IDENTITY,
        Inertial(1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01, 0.0, 0.0, 0.0)),
        (Placed(Box((LENGTHS.ground, 0.04, 0.02)), (LENGTHS.ground / 2.0, 0.0, -0.1)),),  # below the rods
    )
    links = (
        stand,
        _rod("crank", "stand", (0.0, 0.0, 0.0), LENGTHS.crank),
        _rod("coupler", "crank", (LENGTHS.crank, 0.0, _ABOVE), LENGTHS.coupler),
        _rod("rocker", "stand", (LENGTHS.ground, 0.0, 0.0), LENGTHS.rocker),
    )
    steel = Material("steel", static_friction=0.3, kinetic_friction=0.3, restitution=0.0)
    pin = Loop("coupler", "rocker", (LENGTHS.coupler, 0.0, -_ABOVE), (LENGTHS.rocker, 0.0, 0.0), SPEED)
    crank, coupler, rocker = LENGTHS.angles(START).tolist()
    return Scene(
        name="four-bar",
        summary="a crank turns a rocker by way of a coupler: a loop that has to stay closed, with a known period",
        bodies=(),
        robot=Robot(
            "four-bar",
            links,
            (crank, coupler, rocker),
            steel,
            apart=(
                ("stand", "crank"),
                ("stand", "coupler"),
                ("stand", "rocker"),
                ("crank", "rocker"),
                ("coupler", "rocker"),
            ),
            drawn=(0.5, 0.0, 0.0),
            loop=pin,
        ),
        sample_time=10.0,
    )


def _rod(name: str, parent: str, position: Vector, length: float) -> Link:
    mass, shape = MASS[name], Capsule(_RADIUS, length)
    across, _, along = solid_inertia(shape, mass)
    centre: Vector = (length / 2.0, 0.0, 0.0)
    return Link(
        name,
        parent,
        position,
        IDENTITY,
        Inertial(mass, centre, (along, across, across, 0.0, 0.0, 0.0)),
        (Placed(shape, centre, _ALONG),),
        Hinge(f"{name}_turn", -_LIMIT, _LIMIT, 20.0, 1.0, stiffness=0.0, damping=0.0, friction=0.0, armature=0.0),
    )
