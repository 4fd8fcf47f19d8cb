"""Two double pendulums without friction: a large swing that keeps its energy, a small one with known normal modes.

    large    both rods begin at 0.8 rad; no closed form tells its motion
    small    begins within 0.01 rad, where the motion is a sum of two vibrations

Nothing touches anything and no motor acts. Angles of the lower rods are relative to the upper ones. With `--initial
random:SPREAD` every environment begins with its own angles; the small swing stays small.
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

MASS = 1.0
LENGTH = 0.5  # of a rod, from joint to joint
START = {"large": (0.8, 0.0), "small": (0.005, -0.0075)}
_DRAWN = {"large": (0.15, 0.15), "small": (0.002, 0.002)}
_PLACE = {"large": -0.4, "small": 0.4}  # along the axes [m]
_LIMIT = 2.9  # which no rod reaches: the energy is not enough for the lower one to turn over

_ROD = Capsule(radius=0.02, length=0.4)
_HALF = math.sqrt(0.5)
_DOWN: Quaternion = (_HALF, _HALF, 0.0, 0.0)  # the joint's axis is level, and the link's y axis points up


def double_pendulum() -> Scene:
    """The scene; angles 0 hang down."""
    stand = Link(
        "stand",
        "",
        (0.0, 0.0, 1.5),
        IDENTITY,
        Inertial(1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01, 0.0, 0.0, 0.0)),
        (Placed(Box((0.1, 0.1, 0.1))),),  # between the pendulums, which never meet it
    )
    links = [stand]
    for name, y in _PLACE.items():
        links.append(_rod(f"{name}_upper", "stand", (0.0, y, 0.0), _DOWN))
        links.append(_rod(f"{name}_lower", f"{name}_upper", (0.0, -LENGTH, 0.0), IDENTITY))
    steel = Material("steel", static_friction=0.3, kinetic_friction=0.3, restitution=0.0)
    return Scene(
        name="double-pendulum",
        summary="two double pendulums swing freely: a large swing keeps its energy, a small one has known periods",
        bodies=(),
        robot=Robot(
            "double-pendulum",
            tuple(links),
            tuple(angle for name in _PLACE for angle in START[name]),
            steel,
            apart=tuple(("stand", f"{name}_{rod}") for name in _PLACE for rod in ("upper", "lower")),
            drawn=tuple(share for name in _PLACE for share in _DRAWN[name]),
        ),
        sample_time=10.0,
    )


def _rod(name: str, parent: str, position: Vector, orientation: Quaternion) -> Link:
    across, _, along = solid_inertia(_ROD, MASS)
    centre: Vector = (0.0, -LENGTH / 2.0, 0.0)
    return Link(
        name,
        parent,
        position,
        orientation,
        Inertial(MASS, centre, (across, along, across, 0.0, 0.0, 0.0)),
        (Placed(_ROD, centre, _DOWN),),
        Hinge(f"{name}_swing", -_LIMIT, _LIMIT, 20.0, 1.0, stiffness=0.0, damping=0.0, friction=0.0, armature=0.0),
    )
