"""Unit quaternions wxyz, as arrays [..., 4]; where a link is in its parent's frame, by the values of its joints; and
MuJoCo's qpos, as tasks are recorded with it, taken apart into states of bodies and joints."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.fields import ENV, StateField, body_field, joint_field
from gpusimbench.schemas.vector import PHYSICS

Vector = tuple[float, ...]

Key = tuple[str, str]
"""Group and name of a body or link."""

Placed = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Positions [row, 3] [m] and orientations [row, 4] wxyz."""

ROBOT = "robot"
"""Group of links: of the robot of a scene, and of every body of a model that is not free."""


def about(axis: Sequence[float], angle: NDArray[Any]) -> NDArray[np.float64]:
    """Rotations about a unit vector by angles [rad], any shape; returns [..., 4]."""
    half = np.asarray(angle, dtype=np.float64) / 2
    return np.stack([np.cos(half), *(np.sin(half) * part for part in axis)], axis=-1)


def unit(quaternion: NDArray[Any]) -> NDArray[np.float64]:
    """Quaternions [..., 4] at length 1; those of length 0 as they are."""
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return np.asarray(quaternion / np.where(length > 0, length, 1.0), dtype=np.float64)


def product(first: NDArray[Any], then: NDArray[Any]) -> NDArray[np.float64]:
    """Hamilton product: `then` is a rotation in the frame that `first` leads to; shapes broadcast."""
    first, then = np.broadcast_arrays(np.asarray(first, dtype=np.float64), np.asarray(then, dtype=np.float64))
    w, v = first[..., :1], first[..., 1:]
    u, r = then[..., :1], then[..., 1:]
    return np.concatenate([w * u - (v * r).sum(-1, keepdims=True), w * r + u * v + np.cross(v, r)], axis=-1)


def rotate(quaternion: NDArray[Any], vector: NDArray[Any]) -> NDArray[np.float64]:
    """Vectors [..., 3] turned by unit quaternions [..., 4]."""
    w, v = quaternion[..., :1], quaternion[..., 1:]
    cross = np.cross(v, vector)
    turned: NDArray[np.float64] = np.asarray(vector + 2 * w * cross + 2 * np.cross(v, cross), dtype=np.float64)
    return turned


@dataclass(frozen=True)
class Joint:
    """A hinge, a slide or a ball joint.

    kind         "hinge", "slide" or "ball"
    group, name  that its values are recorded under: of a ball joint orientations, of others qpos
    axis         unit vector in the link's frame; of a ball joint without meaning
    anchor       in the link's frame [m]; the link turns about it
    reference    value at which the link is where it is described [rad or m]
    """

    kind: str
    group: str
    name: str
    axis: Vector = (0.0, 0.0, 1.0)
    anchor: Vector = (0.0, 0.0, 0.0)
    reference: float = 0.0

    @property
    def field(self) -> str:
        """Name of the state field with its values."""
        return f"{self.group}/{'orientation' if self.kind == 'ball' else 'qpos'}"


@dataclass(frozen=True)
class Link:
    """How a link hangs on another.

    parent       that it hangs on; None for the env's frame
    position     in the parent's frame, at the joints' references [m]
    orientation  the same, wxyz
    joints       in order: each moves the link in the frame that those before it lead to
    """

    name: str
    parent: Key | None
    position: Vector
    orientation: Vector
    joints: tuple[Joint, ...] = ()

    def placed(self, values: Sequence[NDArray[np.float64]], n_row: int) -> Placed:
        """Its pose in the parent's frame at n_row rows.

        values  of each joint: [row, 1], of a ball joint [row, 4]
        """
        position: NDArray[np.float64] = np.broadcast_to(np.array(self.position), (n_row, 3))
        orientation: NDArray[np.float64] = np.broadcast_to(np.array(self.orientation), (n_row, 4))
        for joint, value in zip(self.joints, values, strict=True):
            if joint.kind == "slide":
                position = position + rotate(orientation, np.array(joint.axis)) * (value - joint.reference)
                continue
            turn = unit(value) if joint.kind == "ball" else about(joint.axis, value[:, 0] - joint.reference)
            turned = product(orientation, turn)
            if any(joint.anchor):
                anchor = np.array(joint.anchor)
                position = position + rotate(orientation, anchor) - rotate(turned, anchor)
            orientation = turned
        return position, orientation


QPOS = f"{ENV}/{PHYSICS}qpos"
"""The field of a task's recording that has it, one item of as many numbers as the model has coordinates."""

_PARTS = {
    "free": (("position", 3), ("orientation", 4)),
    "hinge": (("qpos", 1),),
    "slide": (("qpos", 1),),
    "ball": (("orientation", 4),),
}


class Coordinate(NamedTuple):
    """A joint of a model, in the order of qpos.

    kind         "free", "hinge", "slide" or "ball"
    group, name  as geometry.json has them
    """

    kind: str
    group: str
    name: str


@dataclass(frozen=True)
class Coordinates:
    """Where in qpos the states of bodies and joints are.

    fields   of these states, as recordings of models have them
    columns  of qpos, [item, width], one a field
    """

    fields: tuple[StateField, ...]
    columns: tuple[NDArray[np.int64], ...]

    def states(self, qpos: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Arrays [row, item, width] by the names of fields, from qpos [row, 1, coordinate]."""
        return {
            field.name: qpos[:, 0][:, columns] for field, columns in zip(self.fields, self.columns, strict=True)
        }  # fmt: skip


def coordinates_of(order: Iterable[Coordinate], known: Mapping[str, StateField]) -> Coordinates | None:
    """How to take qpos apart; None where it was not recorded, other states were, or the model has other coordinates.

    order  of the model's joints
    known  recorded fields by name
    """
    recorded = known.get(QPOS)
    if recorded is None or any(field.group != ENV for field in known.values()):
        return None
    found: dict[tuple[str, str], list[tuple[str, range]]] = {}
    at = 0
    for kind, group, name in order:
        for part, width in _PARTS[kind]:
            found.setdefault((group, part), []).append((name, range(at, at + width)))
            at += width
    if not found or at != recorded.width:
        return None
    fields = [
        (joint_field if part == "qpos" else body_field)(group, part, recorded.dtype, tuple(name for name, _ in items))
        for (group, part), items in found.items()
    ]
    return Coordinates(tuple(fields), tuple(np.array([list(at) for _, at in items]) for items in found.values()))
