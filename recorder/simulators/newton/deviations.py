"""What Newton's solvers do with the contact parameters of a scene."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import (
    LARGER,
    MEAN,
    combination,
    materials_and_robot,
    one_friction,
    other_restitution,
    unlimited_speed,
)
from gpusimbench.recorder.simulators.newton.options import NewtonOptions
from gpusimbench.schemas.provenance import Deviation

_ONE_FRICTION = "Newton has one friction coefficient a shape; the kinetic one is used"

_FRICTION_OF_A_PAIR = {
    "mujoco": LARGER,
    "xpbd": MEAN,
    "steel": MEAN,
    "semi-implicit": MEAN,
    "featherstone": MEAN,
    "vbd": "the geometric mean of the two coefficients",
    "kamino": MEAN,
}

_NO_RESTITUTION = {
    "mujoco": "contacts are damped springs of ke and kd",
    "semi-implicit": "contacts are damped springs of ke and kd",
    "featherstone": "contacts are damped springs of ke and kd",
    "vbd": "contacts are damped springs of ke and kd",
}

_STICTION = {
    "steel": "friction patches hold what rests by a spring along the surface, up to the same coefficient",
    "semi-implicit": "friction is viscous, of gain kf, up to the coefficient: nothing sticks",
    "featherstone": "friction is viscous, of gain kf, up to the coefficient: nothing sticks",
    "vbd": "friction is smoothed below a slip of friction_epsilon: nothing sticks",
}


def deviations(scene: Scene, options: NewtonOptions) -> tuple[Deviation, ...]:
    """The parameters that the chosen solver honours otherwise than the scene gives them, or not at all."""
    solver = options.solver
    found = [combination("friction", _FRICTION_OF_A_PAIR[solver], f"rule of {solver}")]
    for material in materials_and_robot(scene):
        found += [
            one_friction(material, f"{_ONE_FRICTION}; {_STICTION[solver]}" if solver in _STICTION else _ONE_FRICTION),
            other_restitution(material, *_restitution(solver, options.rebounds, material.restitution)),
        ]
    if scene.robot is not None:
        found.append(unlimited_speed(scene.robot, "MJCF, by which Newton reads robots, has no velocity limits"))
        if solver != "mujoco" and any(joint.stiffness or joint.damping for joint in scene.robot.joints()):
            torques = " ".join(str(joint.max_torque) for joint in scene.robot.joints())
            found.append(Deviation("joint.max_torque", torques, "not enforced", f"servos of {solver} have no limit"))
    return tuple(found)


def _restitution(solver: str, switched_on: bool, wanted: float) -> tuple[str, str]:
    if solver in _NO_RESTITUTION:
        return "none of its own", f"{solver} has no coefficient of restitution: {_NO_RESTITUTION[solver]}"
    if solver == "kamino":
        return str(wanted), "of a pair the smaller coefficient"
    if not switched_on:
        return "0", f"{solver} is not asked for it (option 'restitution')"
    if solver == "steel":
        return str(wanted), "of a pair the mean of the two; only where they close faster than 0.5 m/s"
    return str(wanted), "of a pair the mean of the two"
