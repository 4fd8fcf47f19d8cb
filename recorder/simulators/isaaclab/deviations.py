"""What Isaac Lab's backends do with the contact parameters of a scene."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import LARGER, combination, materials, rest_offset, springs
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.isaaclab.scene import BODY_LIMITS
from gpusimbench.recorder.simulators.physx.deviations import patch_friction
from gpusimbench.schemas.provenance import Deviation

_NOT_OF_MODELS = ("contact.restitution_combination", "contact.restitution", "angular_velocity.limit")
"""Contacts of model files have no restitution, and their links may turn at any speed."""


def deviations(scene: Scene, options: IsaacLabOptions) -> tuple[Deviation, ...]:
    """The parameters that the backend honours otherwise than the scene gives them, or not at all."""
    if options.backend == "newton":
        return () if isinstance(scene, ModelScene) else _newton(scene)
    found = _physx(options)
    if isinstance(scene, ModelScene):
        return tuple(deviation for deviation in found if deviation.parameter not in _NOT_OF_MODELS)
    return found


def _physx(options: IsaacLabOptions) -> tuple[Deviation, ...]:
    found = [
        combination(name, f"{how} of the two coefficients", f"option '{name}_combine'")
        for name, how in (("friction", options.friction_combine), ("restitution", options.restitution_combine))
    ]
    found += [patch_friction("its distances are PhysX's defaults"), *rest_offset(options.rest_offset)]
    found.append(
        Deviation(
            "angular_velocity.limit",
            "none",
            f"{BODY_LIMITS['max_angular_velocity']} deg/s",
            "PhysX limits how fast a body turns; this is its default",
        )
    )
    if options.bounce_threshold:
        found.append(
            Deviation(
                "contact.restitution",
                "at any speed",
                f"only where two close faster than {options.bounce_threshold:g} m/s",
                "option 'bounce_threshold'",
            )
        )
    return tuple(found)


def _newton(scene: Scene) -> tuple[Deviation, ...]:
    said = springs(
        materials(scene),
        "Newton has one friction coefficient a shape; Isaac Lab gives it the kinetic one",
        "none of its own",
        "MuJoCo Warp has no coefficient of restitution: contacts are damped springs",
    )
    return (combination("friction", LARGER, "rule of MuJoCo Warp"), *said)
