"""What a scene looks like: the shapes of its bodies and links, from scene.json."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.view.kinematics import ROBOT, Joint, Key, Link, Vector

IDENTITY: Vector = (1.0, 0.0, 0.0, 0.0)
MAX_LINKS = 1000
"""Each is written for every row that is shown."""

_PLANE_M = 4.0  # a plane has no end; so much of it is drawn


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    points     [point, 3] [m]
    triangles  [triangle, 3], numbers of points, counter-clockwise as seen from outside
    """

    points: NDArray[np.float64]
    triangles: NDArray[np.int64]


@dataclass(frozen=True)
class Shape:
    """A shape at a pose in its solid's frame.

    kind         "box", "sphere", "capsule", "cylinder", "ellipsoid" or "mesh"; a plane is drawn as a thin box
    size         of a box: edges; of a sphere: radius; of a capsule along z: radius, length between its centres; of a
                 cylinder along z: radius, length; of an ellipsoid: diameters; of a mesh: edges of a box about its
                 origin that holds it [m]
    position     of its centre, or of a mesh's origin [m]
    orientation  unit quaternion wxyz
    mesh         of the kind "mesh"
    """

    kind: str
    size: Vector
    position: Vector = (0.0, 0.0, 0.0)
    orientation: Vector = IDENTITY
    mesh: Mesh | None = None


@dataclass(frozen=True)
class Solid:
    """Something that is drawn: a body, or a robot's link.

    group   of moving bodies; "robot" for links; empty for what is part of the world
    shapes  in its own frame; of what is part of the world, in that of the env
    """

    name: str
    group: str
    shapes: tuple[Shape, ...]


def solids_of(scene: dict[str, Any]) -> tuple[Solid, ...]:
    """Every body and link with a shape that is known here, in order; DamagedRecording where one is unreadable."""
    return (*_bodies(scene), *_links(scene))


def links_of(scene: dict[str, Any]) -> tuple[Link, ...]:
    """The links of the scene's robot, parents first; empty without one. DamagedRecording where one is unreadable."""
    links = tuple(_link(link) for link in checks.objects(checks.mapping(scene, "robot"), "links"))
    if len(links) > MAX_LINKS:
        raise DamagedRecording(f"a robot of {len(links)} links; at most {MAX_LINKS} are drawn")
    known: set[Key | None] = {None}
    for link in links:
        if link.parent not in known or (ROBOT, link.name) in known or not link.name:
            raise DamagedRecording(f"the link {link.name!r} is there twice, or before its parent")
        known.add((ROBOT, link.name))
    return links


def _bodies(scene: dict[str, Any]) -> Iterator[Solid]:
    for body in checks.objects(scene, "bodies"):
        fixed = body.get("mass") is None
        shapes = shape_of(body, *(_pose(body) if fixed else ((0.0, 0.0, 0.0), IDENTITY)))
        yield Solid(checks.text(body, "name"), "" if fixed else checks.text(body, "group"), shapes)


def _links(scene: dict[str, Any]) -> Iterator[Solid]:
    for link in checks.objects(checks.mapping(scene, "robot"), "links"):
        shapes = tuple(s for placed in checks.objects(link, "shapes") for s in shape_of(placed, *_pose(placed)))
        yield Solid(checks.text(link, "name"), ROBOT, shapes)


def _link(record: dict[str, Any]) -> Link:
    joint = checks.mapping(record, "joint")
    name, parent = checks.text(record, "name"), checks.text(record, "parent", default="")
    joints = (Joint("hinge", ROBOT, checks.text(joint, "name")),) if joint else ()
    return Link(name, (ROBOT, parent) if parent else None, *_pose(record), joints)


def _pose(record: dict[str, Any]) -> tuple[Vector, Vector]:
    position = checks.vector(record.get("position", [0.0, 0.0, 0.0]), 3, "a position")
    return position, checks.vector(record.get("orientation", list(IDENTITY)), 4, "an orientation")


def shape_of(
    record: dict[str, Any], position: Vector, orientation: Vector, meshes: Sequence[Mesh] | None = None
) -> tuple[Shape, ...]:
    """The shape that a record describes, at a pose; none of a kind of a later version, whose frame is drawn.

    meshes  that shapes name by their number; None in a scene, whose shapes are boxes, spheres, capsules and planes
    """
    shape = checks.mapping(record, "shape")
    kind, mesh = shape.get("kind"), None
    match kind:
        case "box":
            size = checks.vector(shape.get("size"), 3, "a box's size")
        case "sphere":
            size = (checks.number(shape, "radius", 0, 1e6),)
        case "capsule":
            size = (checks.number(shape, "radius", 0, 1e6), checks.number(shape, "length", 0, 1e6))
        case "plane":
            edges = checks.vector(shape.get("size", [_PLANE_M, _PLANE_M]), 2, "a plane's size")
            return (Shape("box", (*edges, 1e-4), position, orientation),)
        case "ellipsoid" if meshes is not None:
            size = checks.vector(shape.get("size"), 3, "an ellipsoid's size")
        case "cylinder" if meshes is not None:
            size = (checks.number(shape, "radius", 0, 1e6), checks.number(shape, "length", 0, 1e6))
        case "mesh" if meshes is not None:
            mesh = meshes[checks.whole(shape, "mesh", 0, len(meshes) - 1)]
            size = tuple(2 * float(reach) for reach in np.abs(mesh.points).max(axis=0))
        case _:
            return ()
    return (Shape(str(kind), size, position, orientation, mesh),)
