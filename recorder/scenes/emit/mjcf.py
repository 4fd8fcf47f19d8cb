"""A scene as MJCF, MuJoCo's model language, for every engine that reads it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping

from gpusimbench.recorder.scenes.base import IDENTITY, Body, Box, Capsule, Plane, Robot, Scene, Shape, Sphere, Vector
from gpusimbench.recorder.scenes.emit.deviations import (
    LARGER,
    combination,
    materials_and_robot,
    springs,
    unlimited_speed,
)
from gpusimbench.schemas.provenance import Deviation

_TORSIONAL = 0.005  # [m], MuJoCo's default; without effect at condim 3
_ROLLING = 0.0001  # [m], MuJoCo's default; without effect below condim 6


def _number(value: float) -> str:
    return repr(float(value))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(_number(v) for v in values)


def _geom_shape(shape: Shape) -> dict[str, str]:
    match shape:
        case Box(size):
            return {"type": "box", "size": _numbers(edge / 2 for edge in size)}
        case Sphere(radius):
            return {"type": "sphere", "size": _number(radius)}
        case Capsule(radius, length):
            return {"type": "capsule", "size": _numbers((radius, length / 2))}
        case Plane():
            return {"type": "plane", "size": "0 0 1"}


def _add_body(world: ET.Element, body: Body) -> None:
    geom = {
        "name": body.name,
        **_geom_shape(body.shape),
        "friction": _numbers((body.material.kinetic_friction, _TORSIONAL, _ROLLING)),
    }
    pose = {"pos": _numbers(body.position)}
    if body.orientation != IDENTITY:
        pose["quat"] = _numbers(body.orientation)
    if body.mass is None:
        ET.SubElement(world, "geom", {**geom, **pose})
        return
    element = ET.SubElement(world, "body", {"name": body.name, **pose})
    ET.SubElement(element, "freejoint", {"name": body.name})
    ET.SubElement(element, "geom", {**geom, "mass": _number(body.mass)})


def _pins(robot: Robot) -> list[tuple[str, str, Vector]]:
    """Name, link and place of both ends of the pin that closes a robot's loop, if it has any."""
    loop = robot.loop
    if loop is None:
        return []
    return [("pin_coupler", loop.coupler, loop.on_coupler), ("pin_rocker", loop.rocker, loop.on_rocker)]


def _add_robot(root: ET.Element, world: ET.Element, robot: Robot, stiff: Mapping[str, str]) -> None:
    _add_links(world, robot)
    contact = ET.SubElement(root, "contact")
    for one, other in robot.apart:
        ET.SubElement(contact, "exclude", {"body1": one, "body2": other})
    if pins := [pin for pin, _, _ in _pins(robot)]:
        joined = {"name": "pin", "site1": pins[0], "site2": pins[1], **stiff}
        ET.SubElement(ET.SubElement(root, "equality"), "connect", joined)
    _add_actuators(root, robot)


def _add_links(world: ET.Element, robot: Robot) -> None:
    friction = _numbers((robot.material.kinetic_friction, _TORSIONAL, _ROLLING))
    parents = {"": world}
    for link in robot.links:
        pose = {"pos": _numbers(link.position), "quat": _numbers(link.orientation)}
        element = ET.SubElement(parents[link.parent], "body", {"name": link.name, **pose})
        parents[link.name] = element
        xx, yy, zz, xy, xz, yz = link.inertial.inertia
        ET.SubElement(
            element,
            "inertial",
            {
                "mass": _number(link.inertial.mass),
                "pos": _numbers(link.inertial.centre),
                "fullinertia": _numbers((xx, yy, zz, xy, xz, yz)),
            },
        )
        if link.joint is not None:
            ET.SubElement(
                element,
                "joint",
                {
                    "name": link.joint.name,
                    "type": "hinge",
                    "axis": "0 0 1",
                    "range": _numbers((link.joint.lower, link.joint.upper)),
                    "damping": _number(link.joint.friction),
                    "armature": _number(link.joint.armature),
                },
            )
        for index, placed in enumerate(link.shapes):
            place = {"pos": _numbers(placed.position), "quat": _numbers(placed.orientation)}
            name = f"{link.name}_{index}"
            ET.SubElement(element, "geom", {"name": name, **_geom_shape(placed.shape), "friction": friction, **place})
        for pin, of, at in _pins(robot):
            if of == link.name:
                ET.SubElement(element, "site", {"name": pin, "pos": _numbers(at)})


def _add_actuators(root: ET.Element, robot: Robot) -> None:
    actuator = ET.SubElement(root, "actuator")
    for joint in robot.joints():
        ET.SubElement(
            actuator,
            "position",
            {
                "name": joint.name,
                "joint": joint.name,
                "kp": _number(joint.stiffness),
                "kv": _number(joint.damping),
                "ctrlrange": _numbers((joint.lower, joint.upper)),
                "forcerange": _numbers((-joint.max_torque, joint.max_torque)),
            },
        )


def emit_mjcf(
    scene: Scene,
    *,
    dt: float,
    option: Mapping[str, str],
    geom: Mapping[str, str],
    numerics: Mapping[str, str] | None = None,
    autoreset: bool = True,
) -> str:
    """MJCF of one environment; bodies, joints and geoms carry the scene's names.

    dt         step [s]
    option     further attributes of <option>, such as integrator and cone
    geom       defaults of <geom>, such as solref and condim; a loop's pin has their solref and solimp
    numerics   custom numbers by name, which some engines read
    autoreset  whether the engine knows this flag, by which it is told not to reset states that went bad
    """
    root = ET.Element("mujoco", {"model": scene.name})
    ET.SubElement(root, "compiler", {"angle": "radian", "autolimits": "true"})
    settings = {"timestep": _number(dt), "gravity": _numbers(scene.gravity), **option}
    element = ET.SubElement(root, "option", settings)
    if autoreset:
        # MuJoCo would restart a simulation that went bad, which would look like good data
        ET.SubElement(element, "flag", {"autoreset": "disable"})
    ET.SubElement(ET.SubElement(root, "default"), "geom", dict(geom))
    world = ET.SubElement(root, "worldbody")
    for body in scene.bodies:
        _add_body(world, body)
    if scene.robot is not None:
        _add_robot(root, world, scene.robot, {name: geom[name] for name in ("solref", "solimp") if name in geom})
    custom = ET.SubElement(root, "custom") if numerics else root
    for name, data in (numerics or {}).items():
        ET.SubElement(custom, "numeric", {"name": name, "data": data})
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def deviations(scene: Scene) -> tuple[Deviation, ...]:
    """What MuJoCo's contact model cannot take from the scene.

    One Coulomb coefficient per geom, combined over a pair by the larger of the two; no coefficient of restitution:
    contacts are damped springs (solref, solimp).
    """
    found = [combination("friction", LARGER, "MuJoCo's rule for a pair of geoms of equal priority")]
    found += springs(
        materials_and_robot(scene),
        "MuJoCo has one friction coefficient; the kinetic one is used",
        "0 (critically damped contacts)",
        "MuJoCo has no coefficient of restitution; underdamped contacts of this stiffness gain energy at a step of "
        "0.01 s",
    )
    if scene.robot is not None:
        found.append(unlimited_speed(scene.robot, "MuJoCo's joints have no velocity limit"))
    return tuple(found)
