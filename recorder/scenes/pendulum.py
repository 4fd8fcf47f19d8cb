"""A rod swings about a horizontal axis without friction: its period and its energy are known in closed form.

Nothing touches anything and no motor acts, so an error is that of the joint and of the integrator. With `--initial
random:SPREAD` every environment is released at rest from its own angle.
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
    Robot,
    Scene,
    solid_inertia,
)

MASS = 1.0
LENGTH = 0.5  # from the axis to the centre of mass
START = 1.0
_LIMIT = 2.6  # beyond which the period grows without bound

_ROD = Capsule(radius=0.03, length=0.7)
_HALF = math.sqrt(0.5)
_DOWN = (_HALF, _HALF, 0.0, 0.0)  # the joint's axis is level, and the link's y axis points up


def pendulum() -> Scene:
    """The scene; angle 0 hangs down."""
    across, _, along = solid_inertia(_ROD, MASS)
    rod = Link(
        "rod",
        "stand",
        (0.0, 0.0, 0.0),
        _DOWN,
        Inertial(MASS, (0.0, -LENGTH, 0.0), (across, along, across, 0.0, 0.0, 0.0)),
        (Placed(_ROD, (0.0, -LENGTH, 0.0), _DOWN),),
        Hinge("swing", -_LIMIT, _LIMIT, 20.0, 1.0, stiffness=0.0, damping=0.0, friction=0.0, armature=0.0),
    )
    stand = Link(
        "stand",
        "",
        (0.0, 0.0, 1.5),
        IDENTITY,
        Inertial(1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01, 0.0, 0.0, 0.0)),
        (Placed(Box((0.1, 0.1, 0.1)), (0.0, 0.3, 0.0)),),  # beside the rod, which never meets it
    )
    steel = Material("steel", static_friction=0.3, kinetic_friction=0.3, restitution=0.0)
    return Scene(
        name="pendulum",
        summary="a rod swings freely about a level axis, with period and energy known in closed form",
        bodies=(),
        robot=Robot("pendulum", (stand, rod), (START,), steel, apart=(("stand", "rod"),)),
        sample_time=10.0,
    )
