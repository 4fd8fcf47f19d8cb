"""Messages that viewers draw, by Foxglove's public definitions, from the descriptor set of schemas/proto/foxglove."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.text import line
from gpusimbench.schemas.view import foxglove
from gpusimbench.schemas.view.geometry import IDENTITY, Shape
from gpusimbench.schemas.view.kinematics import Vector, rotate

Colour = tuple[float, float, float]
_NS = 1_000_000_000


def stamp(timestamp: Any, time_ns: int) -> None:
    """Fill a Timestamp [ns]."""
    timestamp.seconds, timestamp.nanos = divmod(time_ns, _NS)


def pose(position: Iterable[float], orientation: Iterable[float]) -> Any:
    """A Pose from a position [m] and a quaternion wxyz."""
    made = message_class("foxglove.Pose")()
    _set_pose(made.position, made.orientation, position, orientation)
    return made


def _set_pose(vector: Any, rotation: Any, position: Iterable[float], orientation: Iterable[float]) -> None:
    vector.x, vector.y, vector.z = position
    rotation.w, rotation.x, rotation.y, rotation.z = orientation


def poses(time_ns: int, frame: str, made: Iterable[Any]) -> Any:
    """Poses in a frame at a time [ns]."""
    message = message_class("foxglove.PosesInFrame")(frame_id=frame)
    stamp(message.timestamp, time_ns)
    message.poses.extend(made)
    return message


def transform(time_ns: int, parent: str, child: str, position: Iterable[float], orientation: Iterable[float]) -> Any:
    """Where a frame is in its parent's at a time [ns]."""
    made = message_class("foxglove.FrameTransform")(parent_frame_id=parent, child_frame_id=child)
    stamp(made.timestamp, time_ns)
    _set_pose(made.translation, made.rotation, position, orientation)
    return made


def log(level: str, text: str, unix_ns: int) -> Any:
    """A line of a log, of a level such as "ERROR", at a time of the calendar [ns]."""
    message = message_class("foxglove.Log")(level=level, message=text, name="gsb")
    stamp(message.timestamp, unix_ns)
    return message


def entity(time_ns: int, frame: str, name: str, shapes: Sequence[Shape], colour: Colour) -> Any:
    """What moves with a frame, from a time [ns] on for good."""
    made = message_class("foxglove.SceneEntity")(frame_id=frame, id=name, frame_locked=True)
    stamp(made.timestamp, time_ns)
    for shape in shapes:
        _ADD[shape.kind](made, shape, colour)
    return made


def _add_box(entity: Any, shape: Shape, colour: Colour) -> None:
    _place(entity.cubes.add(), shape.position, shape.orientation, shape.size, colour)


def _add_sphere(entity: Any, shape: Shape, colour: Colour) -> None:
    _place(entity.spheres.add(), shape.position, shape.orientation, (2 * shape.size[0],) * 3, colour)


def _add_capsule(entity: Any, shape: Shape, colour: Colour) -> None:
    radius, length = shape.size
    _add_cylinder(entity, shape, colour)
    for end in (-length / 2, length / 2):
        centre = np.array(shape.position) + rotate(np.array(shape.orientation), np.array([0.0, 0.0, end]))
        _place(entity.spheres.add(), centre.tolist(), IDENTITY, (2 * radius,) * 3, colour)


def _add_cylinder(entity: Any, shape: Shape, colour: Colour) -> None:
    radius, length = shape.size
    tube = entity.cylinders.add(bottom_scale=1.0, top_scale=1.0)
    _place(tube, shape.position, shape.orientation, (2 * radius, 2 * radius, length), colour)


def _add_ellipsoid(entity: Any, shape: Shape, colour: Colour) -> None:
    _place(entity.spheres.add(), shape.position, shape.orientation, shape.size, colour)


def _add_mesh(entity: Any, shape: Shape, colour: Colour) -> None:
    assert shape.mesh is not None
    made = entity.triangles.add(indices=shape.mesh.triangles.ravel().tolist())
    for x, y, z in shape.mesh.points.tolist():
        made.points.add(x=x, y=y, z=z)
    made.pose.CopyFrom(pose(shape.position, shape.orientation))
    _paint(made, colour)


def _place(primitive: Any, position: Vector, orientation: Vector, size: Vector, colour: Colour) -> None:
    primitive.pose.CopyFrom(pose(position, orientation))
    primitive.size.x, primitive.size.y, primitive.size.z = size
    _paint(primitive, colour)


def _paint(primitive: Any, colour: Colour) -> None:
    primitive.color.r, primitive.color.g, primitive.color.b = colour
    primitive.color.a = 1.0


_ADD = {
    "box": _add_box,
    "sphere": _add_sphere,
    "capsule": _add_capsule,
    "cylinder": _add_cylinder,
    "ellipsoid": _add_ellipsoid,
    "mesh": _add_mesh,
}


def event_line(kind: str, phase: str, text: str, unix_ns: int) -> Any:
    """A Log of an event: its kind such as "PHASE_BEGIN", the phase, what is said, and its time of the calendar [ns]."""
    said = " ".join(filter(None, (kind.replace("_", " ").lower(), phase, text)))
    return foxglove.log("ERROR" if kind == "GATE" else "INFO", line(said), unix_ns)


def status_line(status: str, reason: str, unix_ns: int, *, good: bool) -> Any:
    """A Log of how a run ended: its status such as "complete", and why."""
    said = f"status {status}{': ' if reason else ''}{reason}"
    return foxglove.log("INFO" if good else "ERROR", line(said), unix_ns)
