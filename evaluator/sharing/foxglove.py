"""Messages that viewers draw, from the public definitions of Foxglove (package foxglove-schemas-protobuf)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from evaluator.sharing.rotation import rotate
from evaluator.sharing.shapes import IDENTITY, Shape, Vector
from schemas.errors import UsageError

Colour = tuple[float, float, float]


@cache
def message_class(name: str) -> Any:
    """The class of a message, such as "SceneUpdate"; UsageError where the package is not installed."""
    try:
        return getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)
    except ImportError:
        raise UsageError(
            "a view needs the package foxglove-schemas-protobuf: pip install 'gpusimbench[view]'"
        ) from None


def embedded_schema(name: str) -> bytes:
    """The FileDescriptorSet that a file carries for a message: its definition and all that it refers to."""
    files = FileDescriptorSet()
    _collect(message_class(name).DESCRIPTOR.file, files, set())
    return bytes(files.SerializeToString())


def _collect(file: Any, files: Any, seen: set[str]) -> None:
    if file.name in seen:
        return
    seen.add(file.name)
    for dependency in file.dependencies:
        _collect(dependency, files, seen)
    file.CopyToProto(files.file.add())


def pose(position: Iterable[float], orientation: Iterable[float]) -> Any:
    """A Pose from a position [m] and a quaternion wxyz."""
    made = message_class("Pose")()
    set_pose(made.position, made.orientation, position, orientation)
    return made


def set_pose(vector: Any, rotation: Any, position: Iterable[float], orientation: Iterable[float]) -> None:
    """Fill a message of x, y, z and one of w, x, y, z."""
    vector.x, vector.y, vector.z = position
    rotation.w, rotation.x, rotation.y, rotation.z = orientation


def transform(time_ns: int, parent: str, child: str, position: Iterable[float], orientation: Iterable[float]) -> Any:
    """Where a frame is in its parent's at a time [ns]."""
    made = message_class("FrameTransform")(parent_frame_id=parent, child_frame_id=child)
    made.timestamp.FromNanoseconds(time_ns)
    set_pose(made.translation, made.rotation, position, orientation)
    return made


def entity(time_ns: int, frame: str, name: str, shapes: Sequence[Shape], colour: Colour) -> Any:
    """What moves with a frame, from a time [ns] on for good."""
    made = message_class("SceneEntity")(frame_id=frame, id=name, frame_locked=True)
    made.timestamp.FromNanoseconds(time_ns)
    for shape in shapes:
        _ADD[shape.kind](made, shape, colour)
    return made


def _add_box(entity: Any, shape: Shape, colour: Colour) -> None:
    _place(entity.cubes.add(), shape.position, shape.orientation, shape.size, colour)


def _add_sphere(entity: Any, shape: Shape, colour: Colour) -> None:
    _place(entity.spheres.add(), shape.position, shape.orientation, (2 * shape.size[0],) * 3, colour)


def _add_capsule(entity: Any, shape: Shape, colour: Colour) -> None:
    radius, length = shape.size
    tube = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    _place(tube, shape.position, shape.orientation, (2 * radius, 2 * radius, length), colour)
    for end in (-length / 2, length / 2):
        centre = np.array(shape.position) + rotate(np.array(shape.orientation), np.array([0.0, 0.0, end]))
        _place(entity.spheres.add(), centre.tolist(), IDENTITY, (2 * radius,) * 3, colour)


def _place(primitive: Any, position: Vector, orientation: Vector, size: Vector, colour: Colour) -> None:
    primitive.pose.CopyFrom(pose(position, orientation))
    primitive.size.x, primitive.size.y, primitive.size.z = size
    primitive.color.r, primitive.color.g, primitive.color.b = colour
    primitive.color.a = 1.0


_ADD = {"box": _add_box, "sphere": _add_sphere, "capsule": _add_capsule}
