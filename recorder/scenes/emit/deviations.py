"""What several engines do otherwise than a scene says, in the same way."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Robot
from gpusimbench.schemas.provenance import Deviation


def unlimited_speed(robot: Robot, why: str) -> Deviation:
    """The published speed limits of the joints, which are not enforced."""
    return Deviation(
        "joint.max_velocity", " ".join(str(joint.max_velocity) for joint in robot.joints()), "not enforced", why
    )
