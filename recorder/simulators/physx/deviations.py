"""What PhysX does with the contact parameters of a scene."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import combination, rest_offset, unlimited_speed
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.physx.options import NO_THRESHOLD, PhysxOptions
from gpusimbench.schemas.provenance import Deviation

_RULES = {
    "average": "the mean of the two",
    "min": "the smaller of the two",
    "max": "the larger of the two",
    "multiply": "the product of the two",
}


def patch_friction(where: str) -> Deviation:
    """PhysX's friction model, the same in all that stands on it."""
    return Deviation(
        "contact.friction",
        "at each point of contact",
        "at two points of each patch of contact",
        f"PhysX's friction model; {where}",
    )


def deviations(scene: Scene, options: PhysxOptions) -> tuple[Deviation, ...]:
    """The three numbers of each material are honoured; how they meet, and where they begin to count, is the engine's.

    Only scenes with contacts have any.
    """
    model = isinstance(scene, ModelScene)  # whose materials are compared pair by pair
    if not scene.bodies and scene.robot is None and not model:
        return ()
    found = (
        []
        if model
        else [
            combination(name, f"of a pair {_RULES[mode]}, for {what}", f"option '{name}_combine'")
            for name, mode, what in (
                ("friction", options.friction_combine, "static and kinetic friction"),
                ("restitution", options.restitution_combine, "restitution"),
            )
        ]
    )
    if options.bounce_threshold > NO_THRESHOLD:
        found.append(
            Deviation(
                "contact.restitution",
                "at any speed",
                f"only where a pair closes faster than {options.bounce_threshold:g} m/s",
                "option 'bounce_threshold'",
            )
        )
    found.append(patch_friction("option 'friction_correlation_distance' says what makes a patch"))
    if options.max_angular_velocity:
        found.append(
            Deviation(
                "bodies.angular_velocity",
                "not limited",
                f"at most {options.max_angular_velocity:g} rad/s",
                "option 'max_angular_velocity'",
            )
        )
    found += rest_offset(options.rest_offset)
    if scene.robot is not None:
        found.append(unlimited_speed(scene.robot, "no simulator does, so that all compare"))
    return tuple(found)
