"""What a recording looks like: by its scene.json, and where it has one, by the geometry of a compiled model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.view.coordinates import Coordinate
from gpusimbench.schemas.view.kinematics import ROBOT, Joint, Key, Link, Vector, product, rotate
from gpusimbench.schemas.view.shapes import IDENTITY, MAX_LINKS, Mesh, Solid, links_of, shape_of, solids_of

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
        name, (position, orientation) = checks.text(record, "name"), _pose(record)
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
            for shape in shape_of(placed, *_moved(*own, *_pose(placed)), meshes)
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


def _pose(record: dict[str, Any]) -> tuple[Vector, Vector]:
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
