"""What a recording looks like: by its scene.json, and where it has one, by the geometry of a compiled model."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.view.kinematics import ROBOT, Coordinate, Joint, Key, Link, Vector, product, rotate

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


GEOMETRY = "geometry.json"
"""Attachment with the bodies, joints and shapes of a compiled model. It is derived of the model's files, and no part of
the scene's identity: versions of an engine may round it differently."""

MEDIA_TYPE = "application/json"

MAX_SHAPES = 4000
"""Of all bodies together."""

MAX_TRIANGLES = 1 << 16
"""Of all shapes together, and of all meshes together; the points of these are as many at most."""

_JOINTS = 16  # of a body; each is a product of quaternions for every row
_FAR_M = 1e6  # no length is larger, so that nothing overflows


@dataclass(frozen=True)
class Look:
    """What is drawn of a recording.

    solids  bodies and links with their shapes
    links   parents first; bodies that are recorded by their poses are none
    notes   sentences: what is drawn otherwise than it is
    order   joints of a compiled model, in the order of its coordinates
    """

    solids: tuple[Solid, ...] = ()
    links: tuple[Link, ...] = ()
    notes: tuple[str, ...] = ()
    order: tuple[Coordinate, ...] = ()


def look_of(scene: Mapping[str, Any], geometry: Mapping[str, Any] | None = None) -> Look:
    """The look of a scene.json, or of geometry.json where there is one.

    DamagedRecording where one is unreadable, or holds more than is drawn.
    """
    if not geometry:
        return Look(solids_of(dict(scene)), links_of(dict(scene)))
    bodies = checks.objects(geometry, "bodies")
    if len(bodies) > MAX_LINKS or sum(len(checks.items(body, "shapes")) for body in bodies) > MAX_SHAPES:
        raise DamagedRecording(f"{GEOMETRY} has more than {MAX_LINKS} bodies or {MAX_SHAPES} shapes")
    meshes = [_mesh(record) for record in checks.objects(geometry, "meshes")]
    tree = _Tree()
    for record in bodies:
        tree.add(record, meshes)
    drawn = [s.mesh for solid in tree.solids for s in solid.shapes if s.mesh is not None]
    if any(sum(len(mesh.triangles) for mesh in some) > MAX_TRIANGLES for some in (meshes, drawn)):
        raise DamagedRecording(f"{GEOMETRY} has more than {MAX_TRIANGLES} triangles")
    return Look(tuple(tree.solids), tuple(tree.links), checks.texts(geometry, "simplified"), tuple(tree.order))


class _Tree:
    """Bodies one by one, each after its parent.

    What is fixed to the world becomes part of it, by its pose there.
    """

    def __init__(self) -> None:
        self.solids: list[Solid] = []
        self.links: list[Link] = []
        self.order: list[Coordinate] = []
        self._placed: list[tuple[Key | None, Vector, Vector]] = []  # of each body: the frame that it is fixed in
        self._known: set[Key] = set()

    def add(self, record: dict[str, Any], meshes: Sequence[Mesh]) -> None:
        """The next body, from its record."""
        name, (position, orientation) = checks.text(record, "name"), _bounded_pose(record)
        joints = checks.objects(record, "joints")
        if len(joints) > _JOINTS:
            raise DamagedRecording(f"the body {name!r} has {len(joints)} joints; at most {_JOINTS} are read")
        self.order += [Coordinate(*(checks.text(joint, key) for key in ("kind", "group", "name"))) for joint in joints]
        parent: Key | None = None
        if self._placed:
            parent, at, turned = self._placed[checks.whole(record, "parent", 0, len(self._placed) - 1)]
            position, orientation = _moved(at, turned, position, orientation)
        if [joint.get("kind") for joint in joints] == ["free"]:
            key: Key | None = self._new(checks.text(joints[0], "group"), checks.text(joints[0], "name"))
        elif joints or parent is not None:
            key = self._new(ROBOT, name)
            self.links.append(Link(name, parent, position, orientation, tuple(map(_joint, joints))))
        else:
            key = None
        own = ((0.0, 0.0, 0.0), IDENTITY) if key is not None else (position, orientation)
        self._placed.append((key, *own))
        shapes = [
            shape
            for placed in checks.objects(record, "shapes")
            for shape in shape_of(placed, *_moved(*own, *_bounded_pose(placed)), meshes)
        ]
        if any(edge > _FAR_M or edge < 0 for shape in shapes for edge in shape.size):
            raise DamagedRecording(f"the body {name!r} has a shape of a size that is not from 0 to {_FAR_M:g} m")
        self.solids.append(Solid(key[1] if key else name, key[0] if key else "", tuple(shapes)))

    def _new(self, group: str, name: str) -> Key:
        if not group or (group, name) in self._known:
            raise DamagedRecording(f"the body {name!r} is there twice, or of no group")
        self._known.add((group, name))
        return group, name


def _joint(record: dict[str, Any]) -> Joint:
    kind = checks.text(record, "kind")
    group, name = checks.text(record, "group"), checks.text(record, "name")
    if kind not in ("hinge", "slide", "ball"):
        raise DamagedRecording(f"the joint {name!r} is of no kind that is known beside others: {kind[:20]!r}")
    anchor = _vector(record.get("anchor", [0.0, 0.0, 0.0]), "an anchor")
    if kind == "ball":
        return Joint(kind, group, name, anchor=anchor)
    axis = _unit(checks.vector(record.get("axis"), 3, "an axis"), "an axis")
    return Joint(kind, group, name, axis, anchor, checks.number(record, "reference", -_FAR_M, _FAR_M))


def _mesh(record: dict[str, Any]) -> Mesh:
    flat, corners = checks.items(record, "points"), checks.items(record, "triangles")
    n_point = len(flat) // 3
    if any(len(some) % 3 or not 0 < len(some) <= 3 * MAX_TRIANGLES for some in (flat, corners)):
        raise DamagedRecording(f"a mesh of {len(flat)} coordinates and {len(corners)} corners is none that is drawn")
    numbers = checks.vector(flat, len(flat), "the points of a mesh")
    if max(map(abs, numbers)) > _FAR_M or any(type(c) is not int or not 0 <= c < n_point for c in corners):
        raise DamagedRecording(f"a mesh has a point further than {_FAR_M:g} m, or a corner that is none of its points")
    return Mesh(np.array(numbers).reshape(-1, 3), np.array(corners, dtype=np.int64).reshape(-1, 3))


def _bounded_pose(record: dict[str, Any]) -> tuple[Vector, Vector]:
    position = _vector(record.get("position", [0.0, 0.0, 0.0]), "a position")
    orientation = checks.vector(record.get("orientation", list(IDENTITY)), 4, "an orientation")
    return position, _unit(orientation, "an orientation")


def _vector(value: Any, what: str) -> Vector:
    found = checks.vector(value, 3, what)
    if max(map(abs, found)) > _FAR_M:
        raise DamagedRecording(f"{what} is further than {_FAR_M:g} m")
    return found


def _unit(vector: Vector, what: str) -> Vector:
    if not abs(math.hypot(*vector) - 1) < 1e-6:
        raise DamagedRecording(f"{what} is not of length 1")
    return vector


def _moved(at: Vector, turned: Vector, position: Vector, orientation: Vector) -> tuple[Vector, Vector]:
    # a pose in a frame that is itself at a pose; as it is where that is none
    if (at, turned) == ((0.0, 0.0, 0.0), IDENTITY):
        return position, orientation
    there = np.array(at) + rotate(np.array(turned), np.array(position))
    return tuple(there.tolist()), tuple(product(np.array(turned), np.array(orientation)).tolist())
