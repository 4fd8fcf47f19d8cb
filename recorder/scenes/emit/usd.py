"""A scene as USD with the UsdPhysics schema, in the text form (.usda), for every engine that reads it.

Metres, kilograms, z up. The stage has these prims:

    /World/physicsScene       gravity and the engine's own settings
    /World/materials/NAME     contact parameters
    /World/shared/BODY        fixed bodies that all environments have in common
    /World/envs/env0/BODY     the bodies of one environment, for the engine to clone
    /World/envs/env0/ROBOT    links and joints, the articulation's root on ROBOT itself

A body is an Xform at its pose, without scale, and its collider is a child named "shape": a pose that is composed with a
scale would have to be taken apart again, and would lose bits.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np

from gpusimbench.recorder.scenes.base import (
    IDENTITY,
    Body,
    Box,
    Capsule,
    Inertial,
    Link,
    Material,
    Plane,
    Quaternion,
    Robot,
    Scene,
    Shape,
    Sphere,
    Vector,
    solid_inertia,
)
from gpusimbench.recorder.scenes.emit.usd_prim import (
    Apis,
    Prim,
    identifiers,
    literal,
    operation_lines,
    pose_lines,
    stage_text,
    tuple_text,
)
from gpusimbench.recorder.scenes.loop import Loop

ENVS = "/World/envs"
SCENE = "/World/physicsScene"
MATERIALS = "/World/materials"

_PIN = "pin"  # that closes a robot's loop


def env_path(env: int) -> str:
    """Path of the root prim of an environment; number 0 is the one in the file."""
    return f"{ENVS}/env{env}"


def emit_usd(scene: Scene, *, apis: Apis, shared: Collection[str] = ()) -> str:
    """The text of a stage with one environment; prims of bodies, links and joints have the scene's names.

    apis    the engine's own settings by the schema that they belong to: for "PhysxSceneAPI" on the physics scene,
            "PhysxMaterialAPI" on materials, "PhysxCollisionAPI" on colliders, "PhysxRigidBodyAPI" on moving bodies and
            links, "PhysxArticulationAPI" on robots, "PhysxJointAxisAPI:angular" on hinges. Each setting is a
            declaration such as "float physxCollision:restOffset" and its value
    shared  names of the fixed bodies that stand outside of the environment

    ValueError where `shared` names a body that moves, or none.
    """
    fixed = {body.name for body in scene.bodies if body.fixed}
    if unknown := sorted(set(shared) - fixed):
        raise ValueError(f"only fixed bodies of the scene can be shared by all environments, not {', '.join(unknown)}")
    materials = {body.material.name: body.material for body in scene.bodies}
    if scene.robot is not None:
        materials[scene.robot.material.name] = scene.robot.material
    paths = {name: f"{MATERIALS}/{word}" for name, word in identifiers(materials).items()}

    world = Prim("Xform", "World")
    world.add(physics_scene(scene.gravity, apis))
    place = world.add(Prim("Scope", "materials"))
    for name, material in materials.items():
        place.add(material_prim(material, paths[name].rpartition("/")[2], apis))
    common = world.add(Prim("Scope", "shared"))
    env = world.add(Prim("Scope", "envs")).add(Prim("Xform", "env0"))
    names = prim_names(scene)
    for body in scene.bodies:
        parent = common if body.name in shared else env
        parent.add(_body(body, names[body.name], paths[body.material.name], apis))
    if scene.robot is not None:
        env.add(_robot(scene.robot, names[scene.robot.name], paths[scene.robot.material.name], apis))
    return stage_text(world)


def prim_names(scene: Scene) -> dict[str, str]:
    """Names of the prims below an environment, by the names of bodies and of the robot."""
    robot = [] if scene.robot is None else [scene.robot.name]
    return identifiers([*(body.name for body in scene.bodies), *robot])


def physics_scene(gravity: Vector, apis: Apis) -> Prim:
    """The prim at SCENE; gravity [m/s^2]."""
    magnitude = math.hypot(*gravity)
    direction = tuple(g / magnitude for g in gravity) if magnitude else (0.0, 0.0, -1.0)
    prim = Prim("PhysicsScene", SCENE.rpartition("/")[2])
    prim.properties = [
        f"vector3f physics:gravityDirection = {tuple_text(direction)}",
        f"float physics:gravityMagnitude = {literal(magnitude)}",
    ]
    prim.apply(apis, "PhysxSceneAPI")
    return prim


def material_prim(material: Material, name: str, apis: Apis) -> Prim:
    """Contact parameters as a prim of that name."""
    prim = Prim("Material", name, ["PhysicsMaterialAPI"])
    prim.properties = [
        f"float physics:staticFriction = {literal(material.static_friction)}",
        f"float physics:dynamicFriction = {literal(material.kinetic_friction)}",
        f"float physics:restitution = {literal(material.restitution)}",
    ]
    prim.apply(apis, "PhysxMaterialAPI")
    return prim


def _body(body: Body, name: str, material: str, apis: Apis) -> Prim:
    prim = Prim("Xform", name)
    prim.properties = pose_lines(body.position, body.orientation)
    if body.mass is not None:
        prim.apis += ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
        prim.properties += [
            f"vector3f physics:velocity = {tuple_text(body.linear_velocity)}",
            f"vector3f physics:angularVelocity = {tuple_text(math.degrees(w) for w in body.angular_velocity)}",
            f"float physics:mass = {literal(body.mass)}",
            "point3f physics:centerOfMass = (0, 0, 0)",
            f"float3 physics:diagonalInertia = {tuple_text(solid_inertia(body.shape, body.mass))}",
            "quatf physics:principalAxes = (1, 0, 0, 0)",
        ]
        prim.apply(apis, "PhysxRigidBodyAPI")
    prim.add(collider(body.shape, material, apis))
    return prim


def collider(shape: Shape, material: str, apis: Apis) -> Prim:
    """A prim "shape" at the origin of its parent, bound to the material of that path."""
    kind, properties, scale = _geometry(shape)
    prim = Prim(kind, "shape", ["PhysicsCollisionAPI", "MaterialBindingAPI"], properties)
    prim.properties.append(f"rel material:binding:physics = <{material}>")
    if scale is not None:
        prim.properties += operation_lines({"double3 xformOp:scale": tuple_text(scale)})
    prim.apply(apis, "PhysxCollisionAPI")
    return prim


def _geometry(shape: Shape) -> tuple[str, list[str], Vector | None]:
    match shape:
        case Box((x, y, z)) if x == y == z:
            return "Cube", [f"double size = {literal(x)}"], None
        case Box(size):
            return "Cube", ["double size = 1"], size
        case Sphere(radius):
            return "Sphere", [f"double radius = {literal(radius)}"], None
        case Capsule(radius, length):
            sizes = [f"double radius = {literal(radius)}", f"double height = {literal(length)}"]
            return "Capsule", [*sizes, 'uniform token axis = "Z"'], None
        case Plane():
            return "Plane", ['uniform token axis = "Z"'], None


def _robot(robot: Robot, name: str, material: str, apis: Apis) -> Prim:
    root = Prim("Xform", name, ["PhysicsArticulationRootAPI"])
    root.apply(apis, "PhysxArticulationAPI")
    words = identifiers([*(link.name for link in robot.links), *(joint.name for joint in robot.joints()), _PIN])
    path = f"{env_path(0)}/{name}"
    joints = [joint.name for joint in robot.joints()]
    angles, speeds = (dict(zip(joints, numbers, strict=True)) for numbers in (robot.start, robot.speeds()))
    poses: dict[str, tuple[Vector, Quaternion]] = {"": ((0.0, 0.0, 0.0), IDENTITY)}
    for link in robot.links:
        position, orientation = _compose(poses[link.parent], (link.position, link.orientation))
        if link.joint is not None:
            half = angles[link.joint.name] / 2
            turned = (math.cos(half), 0.0, 0.0, math.sin(half))
            position, orientation = _compose((position, orientation), ((0.0, 0.0, 0.0), turned))
        poses[link.name] = (position, orientation)
        root.add(_link(link, words[link.name], poses[link.name], material, apis, _apart(robot, link, path, words)))
        root.add(_joint(link, path, words, angles, speeds, apis))
    if robot.loop is not None:
        root.add(_pin(robot.loop, path, words))
    return root


def _pin(loop: Loop, path: str, words: Mapping[str, str]) -> Prim:
    """What closes a loop: a joint that does not belong to the articulation, which is a tree."""
    prim = Prim("PhysicsRevoluteJoint", words[_PIN])
    prim.properties = [
        'uniform token physics:axis = "Z"',
        "bool physics:excludeFromArticulation = true",
        f"rel physics:body0 = <{path}/{words[loop.coupler]}>",
        f"rel physics:body1 = <{path}/{words[loop.rocker]}>",
        f"point3f physics:localPos0 = {tuple_text(loop.on_coupler)}",
        f"point3f physics:localPos1 = {tuple_text(loop.on_rocker)}",
        *(f"quatf physics:localRot{side} = (1, 0, 0, 0)" for side in (0, 1)),
    ]
    return prim


def _apart(robot: Robot, link: Link, path: str, words: Mapping[str, str]) -> list[str]:
    return [f"<{path}/{words[other]}>" for one, other in robot.apart if one == link.name]


def _link(link: Link, name: str, pose: tuple[Vector, Quaternion], material: str, apis: Apis, apart: list[str]) -> Prim:
    prim = Prim("Xform", name, ["PhysicsRigidBodyAPI", "PhysicsMassAPI"], pose_lines(*pose))
    moments, axes = principal_axes(link.inertial)
    prim.properties += [
        f"float physics:mass = {literal(link.inertial.mass)}",
        f"point3f physics:centerOfMass = {tuple_text(link.inertial.centre)}",
        f"float3 physics:diagonalInertia = {tuple_text(moments)}",
        f"quatf physics:principalAxes = {tuple_text(axes)}",
    ]
    prim.apply(apis, "PhysxRigidBodyAPI")
    if apart:
        prim.apis.append("PhysicsFilteredPairsAPI")
        prim.properties.append(f"rel physics:filteredPairs = [{', '.join(apart)}]")
    for index, placed in enumerate(link.shapes):
        place = prim.add(Prim("Xform", f"shape_{index}"))
        place.properties = pose_lines(placed.position, placed.orientation)
        place.add(collider(placed.shape, material, apis))
    return prim


def _joint(
    link: Link,
    path: str,
    words: Mapping[str, str],
    angles: Mapping[str, float],
    speeds: Mapping[str, float],
    apis: Apis,
) -> Prim:
    """What holds a link: its hinge, or a weld to its parent or to the world."""
    joint = link.joint
    prim = Prim("PhysicsFixedJoint", f"{words[link.name]}_weld")
    if joint is not None:
        prim = Prim("PhysicsRevoluteJoint", words[joint.name], ["PhysicsDriveAPI:angular"])
        prim.properties = [
            'uniform token physics:axis = "Z"',
            f"float physics:lowerLimit = {literal(math.degrees(joint.lower))}",
            f"float physics:upperLimit = {literal(math.degrees(joint.upper))}",
            'uniform token drive:angular:physics:type = "force"',
            f"float drive:angular:physics:stiffness = {literal(math.radians(joint.stiffness))}",
            f"float drive:angular:physics:damping = {literal(math.radians(joint.damping))}",
            f"float drive:angular:physics:maxForce = {literal(joint.max_torque)}",
            f"float drive:angular:physics:targetPosition = {literal(math.degrees(angles[joint.name]))}",
        ]
        prim.apis.append("PhysicsJointStateAPI:angular")
        prim.properties += [
            f"float state:angular:physics:position = {literal(math.degrees(angles[joint.name]))}",
            f"float state:angular:physics:velocity = {literal(math.degrees(speeds[joint.name]) or 0)}",
        ]
        axis = "PhysxJointAxisAPI:angular"
        prim.apis.append(axis)
        prim.properties += [
            f"float physxJointAxis:angular:armature = {literal(joint.armature)}",
            f"float physxJointAxis:angular:viscousFrictionCoefficient = {literal(math.radians(joint.friction))}",
        ]
        prim.properties += [f"{key} = {literal(value)}" for key, value in apis.get(axis, {}).items()]
    if link.parent:
        prim.properties.append(f"rel physics:body0 = <{path}/{words[link.parent]}>")
    w, x, y, z = link.orientation
    prim.properties += [
        f"rel physics:body1 = <{path}/{words[link.name]}>",
        f"point3f physics:localPos0 = {tuple_text(link.position)}",
        f"quatf physics:localRot0 = {tuple_text((w, x, y, z))}",
        "point3f physics:localPos1 = (0, 0, 0)",
        "quatf physics:localRot1 = (1, 0, 0, 0)",
    ]
    return prim


def principal_axes(inertial: Inertial) -> tuple[Vector, Quaternion]:
    """Principal moments of inertia [kg m2], and the orientation of their axes in the link's frame, wxyz."""
    xx, yy, zz, xy, xz, yz = inertial.inertia
    moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    a, b, c = (float(moment) for moment in moments)
    return (a, b, c), _quaternion(axes)


def _quaternion(rotation: np.ndarray) -> Quaternion:
    """Of a rotation matrix, wxyz: the eigenvector of Bar-Itzhack's symmetric matrix to its largest eigenvalue.

    Bar-Itzhack, "New Method for Extracting the Quaternion from a Rotation Matrix", J. Guidance 23 (2000).
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation
    k = np.array([
        [a - e - i, d + b, g + c, h - f],
        [d + b, e - a - i, h + f, c - g],
        [g + c, h + f, i - a - e, d - b],
        [h - f, c - g, d - b, a + e + i],
    ])  # fmt: skip
    x, y, z, w = (float(value) for value in np.linalg.eigh(k)[1][:, -1])
    return (w, x, y, z)


def _compose(outer: tuple[Vector, Quaternion], inner: tuple[Vector, Quaternion]) -> tuple[Vector, Quaternion]:
    """The pose `inner`, given in the frame `outer`, in the frame that `outer` is given in."""
    (ow, *ov), (iw, *iv) = outer[1], inner[1]
    u, v, p = np.array(ov), np.array(iv), np.array(inner[0])
    twice = 2 * np.cross(u, p)
    x, y, z = (float(value) for value in np.array(outer[0]) + p + ow * twice + np.cross(u, twice))
    i, j, k = (float(value) for value in ow * v + iw * u + np.cross(u, v))
    return (x, y, z), (float(ow * iw - u @ v), i, j, k)
