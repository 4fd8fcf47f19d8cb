"""Where the numbers of a state are in MuJoCo's qpos and qvel, part by part."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.fields import StateField, ball_fields, body_fields, joint_field

Array = NDArray[np.floating]
Places = NDArray[np.int64]
Wide = NDArray[np.float64]


@dataclass(frozen=True)
class StateGroup(ABC):
    """A group of bodies or joints of one kind.

    widths            numbers of an item in qpos and in qvel
    group, names      as recorded
    at_qpos, at_qvel  places of their numbers, [item, width]
    """

    widths: ClassVar[tuple[int, int]]
    group: str
    names: tuple[str, ...]
    at_qpos: Places
    at_qvel: Places

    @classmethod
    def of(cls, model: Any, group: str, names: Sequence[str], joints: Sequence[int], **more: Any) -> Self:
        """The part whose items hang on these joints of a mujoco.MjModel, by their numbers."""
        qpos, qvel = (
            np.asarray(address)[np.asarray(joints, dtype=np.int64)].astype(np.int64)[:, None] + np.arange(width)
            for address, width in zip((model.jnt_qposadr, model.jnt_dofadr), cls.widths, strict=True)
        )
        return cls(group, tuple(names), qpos, qvel, **more)

    @abstractmethod
    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """Layout of the arrays of `split`."""

    @abstractmethod
    def split(self, qpos: Array, qvel: Array) -> list[Array]:
        """An array [..., item, width] for each field, of qpos [..., nq] and qvel [..., nv]; views where possible."""

    @abstractmethod
    def join(self, arrays: Iterator[Wide], qpos: Wide, qvel: Wide) -> None:
        """Put the next arrays [env, item, width] into qpos [env, nq] and qvel [env, nv]: the inverse of `split`, but
        for the rounding of what is rotated."""

    def coordinates(self) -> Places:
        """Places in qpos of x, y and z of free bodies."""
        return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class FreeBodies(StateGroup):
    """Bodies on free joints. qpos: position, orientation wxyz; qvel: linear velocity in the world's frame, angular
    velocity in the body's."""

    widths = (7, 6)

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """See StateGroup.fields."""
        note = "rotated by the recorder from the body's frame, in which MuJoCo holds it"
        return body_fields({self.group: self.names}, dtype, {"angular_velocity": note})

    def split(self, qpos: Array, qvel: Array) -> list[Array]:
        """See StateGroup.split."""
        pose, velocity = _picked(qpos, self.at_qpos), _picked(qvel, self.at_qvel)
        turning = rotate_to_world(pose[..., 3:], velocity[..., 3:])
        return [pose[..., :3], pose[..., 3:], velocity[..., :3], turning]

    def join(self, arrays: Iterator[Wide], qpos: Wide, qvel: Wide) -> None:
        """See StateGroup.join."""
        position, orientation, linear, angular = (next(arrays) for _ in range(4))
        qpos[:, self.at_qpos] = np.concatenate([position, orientation], axis=-1)
        qvel[:, self.at_qvel] = np.concatenate([linear, rotate_to_body(orientation, angular)], axis=-1)

    def coordinates(self) -> Places:
        """See StateGroup.coordinates."""
        return self.at_qpos[:, :3].ravel()


class InJointSpace(StateGroup):
    """Joints, as MuJoCo holds them."""

    def split(self, qpos: Array, qvel: Array) -> list[Array]:
        """See StateGroup.split."""
        return [_picked(qpos, self.at_qpos), _picked(qvel, self.at_qvel)]

    def join(self, arrays: Iterator[Wide], qpos: Wide, qvel: Wide) -> None:
        """See StateGroup.join."""
        qpos[:, self.at_qpos], qvel[:, self.at_qvel] = next(arrays), next(arrays)


@dataclass(frozen=True)
class Joints(InJointSpace):
    """Hinges and slides, one number each.

    slides  names of those that slide
    """

    widths = (1, 1)
    slides: frozenset[str] = frozenset()

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """See StateGroup.fields."""
        return tuple(joint_field(self.group, name, dtype, self.names, slides=self.slides) for name in ("qpos", "qvel"))


@dataclass(frozen=True)
class Balls(InJointSpace):
    """Ball joints. qpos: orientation wxyz; qvel: angular velocity in the child body's frame."""

    widths = (4, 3)

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """See StateGroup.fields."""
        return ball_fields(self.group, dtype, self.names)


def _picked(array: Array, index: Places) -> Array:
    # array[..., index]; numbers that lie side by side, as those of one kind of bodies do, are not copied
    first = int(index.flat[0])
    if np.array_equal(index.ravel(), np.arange(first, first + index.size)):
        return array[..., first : first + index.size].reshape(*array.shape[:-1], *index.shape)
    return np.asarray(array[..., index])


def rotate_to_world(quaternion: Array, vector: Array) -> Array:
    """Rotate vectors [..., 3] by unit quaternions wxyz [..., 4]: v + 2 s (u x v) + 2 u x (u x v)."""
    scalar, axis = quaternion[..., :1], quaternion[..., 1:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + scalar * twice + np.cross(axis, twice))


def rotate_to_body(quaternion: Wide, vector: Wide) -> Array:
    """Rotate vectors [..., 3] by the inverse of unit quaternions wxyz [..., 4]."""
    inverse = quaternion * np.array([1.0, -1.0, -1.0, -1.0])
    return rotate_to_world(inverse, vector)
