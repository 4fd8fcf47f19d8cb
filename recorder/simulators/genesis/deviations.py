"""What Genesis' rigid solver does with the contact parameters of a scene."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import (
    LARGER,
    combination,
    materials_and_robot,
    one_friction,
    other_restitution,
    unlimited_speed,
)
from gpusimbench.recorder.scenes.model.scene import ModelScene
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.schemas.provenance import Deviation


def deviations(scene: Scene, options: GenesisOptions) -> tuple[Deviation, ...]:
    """The parameters that Genesis honours otherwise than the scene gives them, or not at all."""
    if isinstance(scene, ModelScene):
        return ()  # its contacts are compared with MuJoCo's, whose rule for a pair is the same
    found = [combination("friction", LARGER, "Genesis' rule for a pair of geoms")]
    for material in materials_and_robot(scene):
        found += [
            one_friction(material, "Genesis has one friction coefficient a geom; the kinetic one is used"),
            other_restitution(
                material,
                "0 (critically damped contacts)",
                "Genesis' rigid contacts have no coefficient of restitution: they are damped springs of the time "
                "constant constraint_timeconst",
            ),
        ]
    if scene.robot is not None:
        found.append(unlimited_speed(scene.robot, "Genesis' joints have no velocity limit"))
        if options.integrator != "Euler":
            found.append(
                Deviation(
                    "joint.max_torque",
                    " ".join(str(joint.max_torque) for joint in scene.robot.joints()),
                    "the same, less the servo's damping",
                    "Genesis' implicit integrators count a servo's damping as part of the inertia, also while its "
                    "torque is at the limit: such a joint accelerates less (--option integrator=Euler does not)",
                )
            )
    return tuple(found)
