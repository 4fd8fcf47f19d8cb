"""A scene's robot as one of SAPIEN's articulations, on a fixed base."""

from __future__ import annotations

from typing import Any

import numpy as np

from gpusimbench.recorder.scenes.base import Hinge, Inertial, Link, Robot
from gpusimbench.recorder.scenes.emit.deviations import unlimited_speed
from gpusimbench.recorder.scenes.emit.usd import principal_axes
from gpusimbench.recorder.simulators.sapien.bodies import X_TO_Z, limit, make_material, make_shape
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.schemas.provenance import Deviation

_ALL, _ROBOT = 1, 1  # the group that meets everything; the number of the only articulation of an environment


def add_arm(scene: Any, robot: Robot, options: SapienOptions) -> Any:
    """Add the robot to a sapien.Scene, at its initial angles; returns the PhysxArticulation."""
    import sapien
    from sapien import physx

    made: dict[str, Any] = {}
    apart = _bits_apart(robot)
    material = make_material(robot.material)
    entities = []
    for link in robot.links:
        component = physx.PhysxArticulationLinkComponent(made.get(link.parent))
        component.name = link.name
        for placed in link.shapes:
            shape = make_shape(placed.shape, material)
            shape.local_pose = sapien.Pose(placed.position, placed.orientation) * shape.local_pose
            shape.set_collision_groups([_ALL, _ALL, apart[link.name], _ROBOT])
            component.attach(shape)
        _set_inertial(component, link.inertial)
        limit(component, options)
        _set_joint(component.joint, link, options)
        entity = sapien.Entity()
        entity.name = link.name
        entity.add_component(component)
        made[link.name] = component
        entities.append(entity)
    articulation = made[robot.links[0].name].articulation
    articulation.solver_position_iterations = options.solver_position_iterations
    articulation.solver_velocity_iterations = options.solver_velocity_iterations
    articulation.sleep_threshold = options.sleep_threshold
    for entity in entities:
        scene.add_entity(entity)
    articulation.qpos = np.array(robot.start, dtype=np.float32)
    for joint, angle in zip(articulation.active_joints, robot.start, strict=True):
        joint.set_drive_target(angle)
    return articulation


def arm_deviations(robot: Robot) -> tuple[Deviation, ...]:
    """What PhysX does otherwise than the robot's description says."""
    joints = robot.joints()
    return (
        Deviation(
            "joint.friction",
            " ".join(f"{joint.friction:g}" for joint in joints) + " N m s/rad, beside the servo",
            "added to the servo's damping, and so within its torque limit",
            "PhysX's joints have dry friction, but no viscous friction of their own",
        ),
        unlimited_speed(robot, "no simulator enforces the limits of the description, so that all compare"),
    )


def _bits_apart(robot: Robot) -> dict[str, int]:
    """For each link a bit for each pair that it is in of those that never collide; links that share one do not meet."""
    bits = {link.name: 0 for link in robot.links}
    for place, pair in enumerate(robot.apart):
        for name in pair:
            bits[name] |= 1 << place
    return bits


def _set_joint(joint: Any, link: Link, options: SapienOptions) -> None:
    import sapien

    # SAPIEN's hinges turn about the x axis of the joint's frame, the description's about the z axis of the link's
    turned = sapien.Pose((0.0, 0.0, 0.0), X_TO_Z)
    hinge = link.joint
    joint.type = "fixed" if hinge is None else "revolute"
    joint.pose_in_parent = sapien.Pose(link.position, link.orientation) * turned
    joint.pose_in_child = turned
    if hinge is None:
        return
    joint.name = hinge.name
    joint.limits = np.array([[hinge.lower, hinge.upper]], dtype=np.float32)
    joint.friction = 0.0
    joint.armature = np.array([hinge.armature], dtype=np.float32)
    joint.max_velocity = options.max_angular_velocity
    joint.set_drive_properties(hinge.stiffness, _damping(hinge), force_limit=hinge.max_torque, mode="force")


def _damping(hinge: Hinge) -> float:
    return hinge.damping + hinge.friction


def _set_inertial(component: Any, inertial: Inertial) -> None:
    import sapien

    moments, axes = principal_axes(inertial)
    component.mass = inertial.mass
    component.cmass_local_pose = sapien.Pose(inertial.centre, axes)
    component.inertia = moments
