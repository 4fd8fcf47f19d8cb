"""From the arrays that Newton holds to the fields of a recording, and back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.captured import States
from gpusimbench.recorder.simulators.mujoco.layout import (
    Array,
    Balls,
    FreeBodies,
    Joints,
    StateGroup,
    Wide,
    rotate_to_world,
)
from gpusimbench.schemas.fields import StateField, ball_fields, body_fields

_TO_WXYZ, _TO_XYZW = [3, 0, 1, 2], [1, 2, 3, 0]


def _reordered(engine: str) -> str:
    return f"reordered by the recorder from {engine}'s xyzw"


class Layout(ABC):
    """Where the numbers of a state are in two arrays of a newton.State, one of positions and one of velocities.

    names  of the two arrays
    """

    names: tuple[str, str]

    @abstractmethod
    def fields(self) -> tuple[StateField, ...]:
        """Layout of the arrays of `split`."""

    @abstractmethod
    def split(self, positions: Array, velocities: Array) -> States:
        """A copy [step, env, item, width] for each field, of two arrays [step, env, number]."""

    @abstractmethod
    def joined(self, states: States) -> tuple[Wide, Wide]:
        """The two arrays [env, number] of such a state [env, item, width]: the inverse of `split`, up to rounding."""


class BodyLayout(Layout):
    """The bodies of a registered scene. Arrays: poses, with quaternions xyzw, and velocities, linear of the centre of
    mass and angular, both in the world's frame."""

    names = ("body_q", "body_qd")

    def __init__(self, scene: Scene) -> None:
        places = {body.name: index for index, body in enumerate(scene.moving())}
        self._names = scene.groups()
        self._groups = [np.array([places[name] for name in names]) for names in self._names.values()]

    def fields(self) -> tuple[StateField, ...]:
        """See Layout.fields."""
        return body_fields(self._names, "float32", {"orientation": _reordered("Newton")})

    def split(self, positions: Array, velocities: Array) -> States:
        """See Layout.split."""
        poses, speeds = (a.reshape(*a.shape[:2], -1, n) for a, n in ((positions, 7), (velocities, 6)))
        arrays: list[Array] = []
        for group in self._groups:
            pose, speed = poses[:, :, group], speeds[:, :, group]
            arrays += [pose[..., :3], pose[..., 3:][..., _TO_WXYZ], speed[..., :3], speed[..., 3:]]
        return tuple(arrays)

    def joined(self, states: States) -> tuple[Wide, Wide]:
        """See Layout.joined."""
        n_env, n_body = len(states[0]), sum(map(len, self._groups))
        poses, speeds = np.empty((n_env, n_body, 7)), np.empty((n_env, n_body, 6))
        left = iter(states)
        for group in self._groups:
            position, orientation, linear, angular = (next(left) for _ in range(4))
            poses[:, group] = np.concatenate([position, orientation[..., _TO_XYZW]], axis=-1)
            speeds[:, group] = np.concatenate([linear, angular], axis=-1)
        return poses.reshape(n_env, -1), speeds.reshape(n_env, -1)


class ModelLayout(Layout):
    """The joints of a model file. Arrays: joint_q and joint_qd.

    parts            as of recorder.simulators.mujoco.layout, with places in joint_q and joint_qd
    joint_q          first state, [number], and
    joint_qd         its velocities
    """

    names = ("joint_q", "joint_qd")

    def __init__(self, parts: tuple[StateGroup, ...], joint_q: Wide, joint_qd: Wide) -> None:
        self.parts, self.joint_q, self.joint_qd = parts, joint_q, joint_qd

    def fields(self) -> tuple[StateField, ...]:
        """See Layout.fields."""
        return tuple(one for part in self.parts for one in part.fields("float32"))

    def split(self, positions: Array, velocities: Array) -> States:
        """See Layout.split."""
        return tuple(np.array(array) for part in self.parts for array in part.split(positions, velocities))

    def joined(self, states: States) -> tuple[Wide, Wide]:
        """See Layout.joined."""
        n_env = len(states[0])
        joint_q, joint_qd = np.tile(self.joint_q, (n_env, 1)), np.tile(self.joint_qd, (n_env, 1))
        left = iter(np.asarray(array, dtype=np.float64) for array in states)
        for part in self.parts:
            part.join(left, joint_q, joint_qd)
        return joint_q, joint_qd


@dataclass(frozen=True)
class NewtonFreeBodies(FreeBodies):
    """Bodies on free joints. joint_q: position, orientation xyzw; joint_qd: velocity of the centre of mass, angular
    velocity, both in the world's frame (newton.State.joint_qd).

    centres  of mass in the bodies' frames, [item, 3] [m]
    engine   that holds them so
    """

    centres: NDArray[np.float32]
    engine: str = "Newton"

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """See StateGroup.fields."""
        note = f"of the body's frame, made by the recorder from {self.engine}'s, which is of the centre of mass"
        notes = {"orientation": _reordered(self.engine), "linear_velocity": note}
        return body_fields({self.group: self.names}, dtype, notes)

    def split(self, qpos: Array, qvel: Array) -> list[Array]:
        """See StateGroup.split."""
        pose, velocity = qpos[..., self.at_qpos], qvel[..., self.at_qvel]
        orientation, turning = pose[..., 3:][..., _TO_WXYZ], velocity[..., 3:]
        return [pose[..., :3], orientation, velocity[..., :3] - self._offset(orientation, turning), turning]

    def join(self, arrays: Iterator[Wide], qpos: Wide, qvel: Wide) -> None:
        """See StateGroup.join."""
        position, orientation, linear, angular = (next(arrays) for _ in range(4))
        qpos[:, self.at_qpos] = np.concatenate([position, orientation[..., _TO_XYZW]], axis=-1)
        qvel[:, self.at_qvel] = np.concatenate([linear + self._offset(orientation, angular), angular], axis=-1)

    def _offset(self, orientation: Array, turning: Array) -> Array:
        # velocity of the centre of mass relative to the frame's origin
        arm = rotate_to_world(orientation, np.broadcast_to(self.centres, turning.shape))
        return np.asarray(np.cross(turning, arm).astype(turning.dtype))


@dataclass(frozen=True)
class NewtonJoints(Joints):
    """Hinges and slides.

    reference  qpos of the reference state, in which Newton's coordinates are zero, [item, 1]
    """

    reference: NDArray[np.float32] = field(default_factory=lambda: np.zeros((1, 1), dtype=np.float32))

    def split(self, qpos: Array, qvel: Array) -> list[Array]:
        """See StateGroup.split."""
        position, velocity = super().split(qpos, qvel)
        return [position + self.reference, velocity]

    def join(self, arrays: Iterator[Wide], qpos: Wide, qvel: Wide) -> None:
        """See StateGroup.join."""
        qpos[:, self.at_qpos], qvel[:, self.at_qvel] = next(arrays) - self.reference, next(arrays)


@dataclass(frozen=True)
class NewtonBalls(Balls):
    """Ball joints. joint_q: orientation xyzw; joint_qd: angular velocity in the parent's frame of the joint."""

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """See StateGroup.fields."""
        return ball_fields(self.group, dtype, self.names)

    def split(self, qpos: Array, qvel: Array) -> list[Array]:
        """See StateGroup.split."""
        orientation = qpos[..., self.at_qpos][..., _TO_WXYZ]
        back = orientation * np.array([1, -1, -1, -1], dtype=orientation.dtype)
        return [orientation, rotate_to_world(back, qvel[..., self.at_qvel])]

    def join(self, arrays: Iterator[Wide], qpos: Wide, qvel: Wide) -> None:
        """See StateGroup.join."""
        orientation, turning = next(arrays), next(arrays)
        qpos[:, self.at_qpos] = orientation[..., _TO_XYZW]
        qvel[:, self.at_qvel] = rotate_to_world(orientation, turning)
