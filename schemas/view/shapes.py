"""What a scene looks like: the shapes of its bodies and links, from scene.json."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Vector = tuple[float, ...]

IDENTITY: Vector = (1.0, 0.0, 0.0, 0.0)
_MAX_LINKS = 1000  # each is written for every row that is shown
_PLANE_M = 4.0  # a plane has no end; so much of it is drawn


@dataclass(frozen=True)
class Shape:
    """A shape at a pose in its solid's frame.

    kind         "box", "sphere" or "capsule"; a plane is drawn as a thin box
    size         of a box: edges; of a sphere: radius; of a capsule along z: radius, length between its centres [m]
    position     of its centre [m]
    orientation  unit quaternion wxyz
    """

    kind: str
    size: Vector
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Vector = IDENTITY


@dataclass(frozen=True)
class Solid:
    """Something that is drawn: a body, or a robot's link.

    group   of moving bodies; "robot" for links; empty for what is part of the world
    shapes  in its own frame; of what is part of the world, in that of the env
    """

    name: str
    group: str
    shapes: tuple[Shape, ...]


@dataclass(frozen=True)
class Link:
    """How a link hangs on another.

    parent       name of the link, empty for the base
    position     in the parent's frame [m]
    orientation  in the parent's frame at joint angle zero, wxyz; the joint turns about its z
    joint        name, empty where the link is fixed
    """

    name: str
    parent: str
    position: Vector
    orientation: Vector
    joint: str


def solids_of(scene: dict[str, Any]) -> tuple[Solid, ...]:
    """Every body and link with a shape that is known here, in order; DamagedRecording where one is unreadable."""
    return (*_bodies(scene), *_links(scene))


def links_of(scene: dict[str, Any]) -> tuple[Link, ...]:
    """The links of the scene's robot, parents first; empty without one. DamagedRecording where one is unreadable."""
    links = tuple(_link(link) for link in checks.objects(checks.mapping(scene, "robot"), "links"))
    if len(links) > _MAX_LINKS:
        raise DamagedRecording(f"a robot of {len(links)} links; at most {_MAX_LINKS} are drawn")
    known = {""}
    for link in links:
        if link.parent not in known or link.name in known:
            raise DamagedRecording(f"the link {link.name!r} is there twice, or before its parent")
        known.add(link.name)
    return links


def _bodies(scene: dict[str, Any]) -> Iterator[Solid]:
    for body in checks.objects(scene, "bodies"):
        fixed = body.get("mass") is None
        shapes = _shape(body, *(_pose(body) if fixed else ((0.0, 0.0, 0.0), IDENTITY)))
        yield Solid(checks.text(body, "name"), "" if fixed else checks.text(body, "group"), shapes)


def _links(scene: dict[str, Any]) -> Iterator[Solid]:
    for link in checks.objects(checks.mapping(scene, "robot"), "links"):
        shapes = tuple(s for placed in checks.objects(link, "shapes") for s in _shape(placed, *_pose(placed)))
        yield Solid(checks.text(link, "name"), "robot", shapes)


def _link(record: dict[str, Any]) -> Link:
    joint = checks.mapping(record, "joint")
    return Link(
        checks.text(record, "name"),
        checks.text(record, "parent", default=""),
        *_pose(record),
        joint=checks.text(joint, "name") if joint else "",
    )


def _pose(record: dict[str, Any]) -> tuple[Vector, Vector]:
    position = checks.vector(record.get("position", [0.0, 0.0, 0.0]), 3, "a position")
    return position, checks.vector(record.get("orientation", list(IDENTITY)), 4, "an orientation")


def _shape(record: dict[str, Any], position: Vector, orientation: Vector) -> tuple[Shape, ...]:
    shape = checks.mapping(record, "shape")
    match shape.get("kind"):
        case "box":
            size = checks.vector(shape.get("size"), 3, "a box's size")
        case "sphere":
            size = (checks.number(shape, "radius", 0, 1e6),)
        case "capsule":
            size = (checks.number(shape, "radius", 0, 1e6), checks.number(shape, "length", 0, 1e6))
        case "plane":
            return (Shape("box", (_PLANE_M, _PLANE_M, 1e-4), position, orientation),)
        case _:
            return ()  # of a later version; its frame is drawn
    return (Shape(str(shape["kind"]), size, position, orientation),)
