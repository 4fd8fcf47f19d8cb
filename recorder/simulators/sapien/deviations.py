"""What PhysX does otherwise than a scene says."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import MEAN, combination
from gpusimbench.recorder.simulators.physx.deviations import patch_friction
from gpusimbench.recorder.simulators.sapien.arm import arm_deviations
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.schemas.provenance import Deviation


def deviations(scene: Scene, options: SapienOptions) -> tuple[Deviation, ...]:
    """The parameters that are honoured otherwise than the scene gives them, with the options in force.

    Static friction, kinetic friction and restitution of each surface are the scene's.
    """
    rule = "PhysX's default rule for a pair of materials"
    found = [
        combination("friction", f"{MEAN}, static and kinetic each", rule),
        combination("restitution", MEAN, rule),
    ]
    if scene.robot is not None:
        found += arm_deviations(scene.robot)
    if not scene.bodies:
        return tuple(found)
    found += [
        patch_friction("its distances are PhysX's defaults, which SAPIEN does not show"),
        Deviation(
            "contact.restitution",
            "at every speed",
            f"none where bodies close at less than {options.bounce_threshold:g} m/s",
            "PhysX stops small bounces (option bounce_threshold)",
        ),
        Deviation(
            "bodies.angular_velocity",
            "not limited",
            f"at most {options.max_angular_velocity:g} rad/s",
            "PhysX limits it (option max_angular_velocity)",
        ),
    ]
    if options.angular_damping:
        found.append(
            Deviation(
                "bodies.angular_damping",
                "none",
                f"{options.angular_damping:g} 1/s",
                "PhysX's default for a body, which is left as it is (option angular_damping)",
            )
        )
    if options.sleep_threshold:
        found.append(
            Deviation(
                "bodies.at_rest",
                "simulated",
                f"put to sleep below {options.sleep_threshold:g} m2/s2 of kinetic energy by mass",
                "PhysX simulates no body that sleeps (option sleep_threshold)",
            )
        )
    return tuple(found)
