"""A Franka Emika Panda on a fixed base, moved to random joint targets (GPUSimBench, franka).

Kinematics, joint limits, velocity and torque limits are Franka Emika's published ones. Masses, centres of mass and
inertias are the identified ones of Gaz et al., "Dynamic Identification of the Franka Emika Panda Robot With Retrieval
of Feasible Parameters Using Penalty-Based Optimization" (RA-L 2019), as the manufacturer's own robot description has
them; servo gains, joint friction and armature are those that MuJoCo models of this robot commonly use. The hand is
rigid, with its fingers closed. Collision shapes are capsules and boxes drawn around the links by this project.

At each step a target is drawn for each of the seven joints, uniformly within its limits.
"""

from __future__ import annotations

import math

from gpusimbench.recorder.scenes.base import (
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
    Shape,
    Vector,
)
from gpusimbench.schemas.action_generator import JointTargets

SHELL = Material("robot shell", static_friction=0.6, kinetic_friction=0.5, restitution=0.0)

_HALF = math.sqrt(0.5)
_X_PLUS: Quaternion = (_HALF, _HALF, 0.0, 0.0)  # +90 degrees about x
_X_MINUS: Quaternion = (_HALF, -_HALF, 0.0, 0.0)
_Z_MINUS_45: Quaternion = (math.cos(math.pi / 8), 0.0, 0.0, -math.sin(math.pi / 8))

_FRICTION = 1.0
_ARMATURE = 0.1

START = (0.0, 0.0, 0.0, -math.pi / 2, 0.0, math.pi / 2, -math.pi / 4)


def _hinge(number: int, lower: float, upper: float, velocity: float, torque: float, stiffness: float) -> Hinge:
    return Hinge(
        f"joint{number}", lower, upper, velocity, torque, stiffness, stiffness / 10.0, _FRICTION, _ARMATURE
    )  # fmt: skip


def _along_z(radius: float, bottom: float, top: float) -> Placed:
    # a capsule whose hemispheres are centred at these heights
    return Placed(Capsule(radius, top - bottom), (0.0, 0.0, (top + bottom) / 2))


def _at(shape: Shape, position: Vector, orientation: Quaternion = IDENTITY) -> Placed:
    return Placed(shape, position, orientation)


_LINKS = (
    Link(
        "link0", "", (0.0, 0.0, 0.0), IDENTITY,
        Inertial(0.629769, (-0.041018, -0.00014, 0.049974),
                 (0.00315, 0.00388, 0.004285, 8.2904e-7, 0.00015, 8.2299e-6)),
        (_at(Box((0.22, 0.19, 0.13)), (-0.04, 0.0, 0.065)),),
    ),
    Link(
        "link1", "link0", (0.0, 0.0, 0.333), IDENTITY,
        Inertial(4.970684, (0.003875, 0.002081, -0.04762),
                 (0.70337, 0.70661, 0.009117, -0.000139, 0.006772, 0.019169)),
        (_along_z(0.06, -0.13, 0.0),),
        _hinge(1, -2.8973, 2.8973, 2.175, 87.0, 4500.0),
    ),
    Link(
        "link2", "link1", (0.0, 0.0, 0.0), _X_MINUS,
        Inertial(0.646926, (-0.003141, -0.02872, 0.003495),
                 (0.007962, 0.02811, 0.025995, -0.003925, 0.010254, 0.000704)),
        (_along_z(0.06, -0.04, 0.04), _at(Capsule(0.06, 0.10), (0.0, -0.06, 0.0), _X_PLUS)),
        _hinge(2, -1.7628, 1.7628, 2.175, 87.0, 4500.0),
    ),
    Link(
        "link3", "link2", (0.0, -0.316, 0.0), _X_PLUS,
        Inertial(3.228604, (0.027518, 0.039252, -0.066502),
                 (0.037242, 0.036155, 0.01083, -0.004761, -0.011396, -0.012805)),
        (_along_z(0.055, -0.13, -0.05), _at(Capsule(0.05, 0.06), (0.0825, 0.0, 0.0), _X_PLUS)),
        _hinge(3, -2.8973, 2.8973, 2.175, 87.0, 3500.0),
    ),
    Link(
        "link4", "link3", (0.0825, 0.0, 0.0), _X_PLUS,
        Inertial(3.587895, (-0.05317, 0.104419, 0.027454),
                 (0.025853, 0.019552, 0.028323, 0.007796, -0.001332, 0.008641)),
        (_along_z(0.05, -0.03, 0.03), _at(Capsule(0.05, 0.05), (-0.0825, 0.09, 0.0), _X_PLUS)),
        _hinge(4, -3.0718, -0.0698, 2.175, 87.0, 3500.0),
    ),
    Link(
        "link5", "link4", (-0.0825, 0.384, 0.0), _X_MINUS,
        Inertial(1.225946, (-0.011953, 0.041065, -0.038437),
                 (0.035549, 0.029474, 0.008627, -0.002117, -0.004037, 0.000229)),
        (_along_z(0.055, -0.24, -0.19), _at(Capsule(0.03, 0.14), (0.0, 0.06, -0.11))),
        _hinge(5, -2.8973, 2.8973, 2.61, 12.0, 2000.0),
    ),
    Link(
        "link6", "link5", (0.0, 0.0, 0.0), _X_PLUS,
        Inertial(1.666555, (0.060149, -0.014117, -0.010517),
                 (0.001964, 0.004354, 0.005433, 0.000109, -0.001158, 0.000341)),
        (_along_z(0.045, -0.05, 0.01), _at(Capsule(0.045, 0.03), (0.07, 0.0, 0.0), _X_PLUS)),
        _hinge(6, -0.0175, 3.7525, 2.61, 12.0, 2000.0),
    ),
    Link(
        "link7", "link6", (0.088, 0.0, 0.0), _X_PLUS,
        Inertial(0.735522, (0.010517, -0.004252, 0.061597),
                 (0.012516, 0.010027, 0.004815, -0.000428, -0.001196, -0.000741)),
        (_along_z(0.04, 0.03, 0.07),),
        _hinge(7, -2.8973, 2.8973, 2.61, 12.0, 2000.0),
    ),
    Link(
        "hand", "link7", (0.0, 0.0, 0.107), _Z_MINUS_45,
        # the hand, and both fingers of 15 g with their frames at 0.0584 m
        Inertial(0.76, (-0.009605, 0.0, 0.031121), (0.001028, 0.002531, 0.001704, 0.0, -8.2e-6, 0.0)),
        (_at(Box((0.06, 0.20, 0.07)), (0.0, 0.0, 0.035)), _at(Box((0.02, 0.04, 0.05)), (0.0, 0.0, 0.09))),
    ),
)  # fmt: skip

PANDA = Robot(
    "panda",
    _LINKS,
    START,
    SHELL,
    apart=(("link0", "link2"), ("link1", "link3"), ("link3", "link5"), ("link5", "link7"), ("link6", "hand")),
)


def franka() -> Scene:
    """The scene: one arm, and a target for each joint at each step."""
    joints = PANDA.joints()
    return Scene(
        name="franka",
        summary="a Franka Panda on a fixed base follows random joint targets, with self-collision",
        bodies=(),
        robot=PANDA,
        actions=JointTargets(
            "joint_target",
            tuple(j.name for j in joints),
            tuple(j.lower for j in joints),
            tuple(j.upper for j in joints),
        ),
    )
