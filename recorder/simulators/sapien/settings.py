"""SAPIEN's process-wide settings: read when a system or a body is made, and set anew for every simulator."""

from __future__ import annotations

import numpy as np

from gpusimbench.recorder.scenes.base import Vector
from gpusimbench.recorder.simulators.sapien.options import SapienOptions


def configure(options: SapienOptions, *, gravity: Vector, enhanced_determinism: bool) -> None:
    """Set what the systems, bodies and shapes that are made from now on will have."""
    from sapien import physx

    physx.set_scene_config(
        gravity=np.array(gravity, dtype=np.float32),
        bounce_threshold=options.bounce_threshold,
        enable_pcm=options.enable_pcm,
        enable_tgs=options.enable_tgs,
        enable_ccd=options.enable_ccd,
        enable_enhanced_determinism=enhanced_determinism,
        enable_friction_every_iteration=options.enable_friction_every_iteration,
        cpu_workers=options.cpu_workers,
    )
    physx.set_body_config(
        solver_position_iterations=options.solver_position_iterations,
        solver_velocity_iterations=options.solver_velocity_iterations,
        sleep_threshold=options.sleep_threshold,
    )
    physx.set_shape_config(contact_offset=options.contact_offset, rest_offset=options.rest_offset)
