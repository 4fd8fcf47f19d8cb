"""A scene's bodies as SAPIEN's entities and components."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.scenes.base import (
    Body,
    Box,
    Capsule,
    Material,
    Plane,
    Quaternion,
    Scene,
    Shape,
    Sphere,
    Vector,
    solid_inertia,
)
from gpusimbench.recorder.simulators.sapien.options import SapienOptions

X_TO_Z: Quaternion = (0.5, -0.5, -0.5, -0.5)
"""Turns PhysX's capsules, which lie along x, and its planes, which face +x.

Exact: the numbers of a quarter turn about y are rounded, which inclines a plane by 2^-23 in float32, and pushes
aside what falls onto it.
"""


def add_bodies(scene: Any, described: Scene, options: SapienOptions, *, planes: bool = True) -> list[Any]:
    """Add the bodies to a sapien.Scene; returns the components of those that move, in the order of Scene.moving.

    planes  False: without infinite planes, where another scene of the same system has them already
    """
    import sapien

    moving = []
    for body in described.bodies:
        if isinstance(body.shape, Plane) and not planes:
            continue
        component = make_component(body, options)
        entity = sapien.Entity()
        entity.name = body.name
        entity.add_component(component)
        entity.set_pose(sapien.Pose(body.position, body.orientation))
        scene.add_entity(entity)
        if not body.fixed:
            # speeds are only kept of a body that is in a scene
            component.linear_velocity = body.linear_velocity
            component.angular_velocity = body.angular_velocity
            moving.append(component)
    return moving


def make_component(body: Body, options: SapienOptions) -> Any:
    """A PhysxRigidStaticComponent or PhysxRigidDynamicComponent of one shape, with the body's mass properties."""
    import sapien
    from sapien import physx

    shape = make_shape(body.shape, make_material(body.material))
    if body.mass is None:
        fixed = physx.PhysxRigidStaticComponent()
        fixed.attach(shape)
        return fixed
    component = physx.PhysxRigidDynamicComponent()
    component.attach(shape)
    component.mass = body.mass
    component.inertia = solid_inertia(body.shape, body.mass)
    component.cmass_local_pose = sapien.Pose()
    limit(component, options)
    return component


def limit(component: Any, options: SapienOptions) -> None:
    """Set what PhysX does to the speeds of a body on its own account."""
    component.linear_damping = 0.0
    component.angular_damping = options.angular_damping
    component.max_angular_velocity = options.max_angular_velocity


def make_material(material: Material) -> Any:
    """A PhysxMaterial; PhysX has all three coefficients."""
    from sapien import physx

    return physx.PhysxMaterial(
        static_friction=material.static_friction,
        dynamic_friction=material.kinetic_friction,
        restitution=material.restitution,
    )


def make_shape(shape: Shape, material: Any) -> Any:
    """A PhysxCollisionShape, turned so that capsules lie along z and planes face +z."""
    import sapien
    from sapien import physx

    match shape:
        case Box(size):
            return physx.PhysxCollisionShapeBox(half_size=half(size), material=material)
        case Sphere(radius):
            return physx.PhysxCollisionShapeSphere(radius=radius, material=material)
        case Capsule(radius, length):
            made = physx.PhysxCollisionShapeCapsule(radius=radius, half_length=length / 2, material=material)
        case Plane():
            made = physx.PhysxCollisionShapePlane(material=material)
    made.local_pose = sapien.Pose((0.0, 0.0, 0.0), X_TO_Z)
    return made


def half(size: Vector) -> Vector:
    """Half of each edge, as PhysX describes a box."""
    x, y, z = size
    return x / 2, y / 2, z / 2
