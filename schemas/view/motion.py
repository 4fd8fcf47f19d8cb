"""How the bodies and links of one environment move, as frames over rows of its states: forward kinematics."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.view.geometry import IDENTITY, Look
from gpusimbench.schemas.view.kinematics import QPOS, ROBOT, Key, Link, Placed, coordinates_of, product, rotate, unit


class MovingPart(NamedTuple):
    """What moves.

    name    of the body or link
    group   that it belongs to
    parent  number of the part that it is relative to; None for the env's frame
    """

    name: str
    group: str
    parent: int | None


@dataclass(frozen=True)
class Frame:
    """A body or link over some rows.

    position     [row, 3] [m]
    orientation  [row, 4], wxyz
    """

    part: MovingPart
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]


def one_of(rate: float, *, dt: float, stride: int) -> int:
    """Of how many recorded rows one is shown, so that at most `rate` are shown in a simulated second."""
    return max(1, math.ceil(1 / (rate * dt * stride) - 1e-9))


class Motion:
    """Frames from the states of an environment; of a task, from MuJoCo's qpos.

    fields  whose states are needed, in this order
    parts   that move, links after their parents; empty where nothing of the state is a place

    origin  of the environment in the engine's world frame [m]; frames are relative to it

    DamagedRecording where the fields are not of the format, or are not those of the look.
    """

    def __init__(self, fields: Sequence[StateField], look: Look, *, origin: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        self._origin = np.array(origin, dtype=np.float64)
        self._known = {field.name: field for field in fields}
        self._coordinates = coordinates_of(look.order, self._known)
        if self._coordinates is not None:
            fields, qpos = self._coordinates.fields, self._known[QPOS]
            self._known = {field.name: field for field in fields}
        self._bodies = [field for field in fields if field.field == "position"]
        asked = dict.fromkeys(joint.field for link in look.links for joint in link.joints)
        joints = [field for name in asked if (field := self._known.get(name)) is not None and _of_joints(field)]
        self._links = look.links if joints or (self._bodies and not asked) else ()
        turned = [f for f in map(self._turned, self._bodies) if f is not None]
        self.fields = tuple(dict.fromkeys((*self._bodies, *turned, *(joints if self._links else ()))))
        self._check()
        free = [MovingPart(name, field.group, None) for field in self._bodies for name in field.items]
        self.parts = tuple(_parts(free, self._links))
        if self._coordinates is not None:
            self.fields = (qpos,)

    def frames(self, states: Sequence[NDArray[Any]]) -> tuple[Frame, ...]:
        """Frames of rows, in the order of `parts`, from an array [row, item, width] of each of `fields`."""
        if self._coordinates is not None:
            by_name = self._coordinates.states(states[0])
        else:
            by_name = {field.name: array for field, array in zip(self.fields, states, strict=True)}
        found = [*self._moved(by_name), *self._hung(by_name)]
        return tuple(Frame(part, *placed) for part, placed in zip(self.parts, found, strict=True))

    def _turned(self, field: StateField) -> StateField | None:
        return self._known.get(f"{field.group}/orientation")

    def _check(self) -> None:
        for field in self._bodies:
            if field.frame not in ("world", "env") or field.components not in (("x", "y"), ("x", "y", "z")):
                raise DamagedRecording(f"{field.name} has a frame or components that are not of this format")
            turned = self._turned(field)
            if turned is not None and (turned.components != ("w", "x", "y", "z") or turned.items != field.items):
                raise DamagedRecording(f"{turned.name} is not of this format")
        for joint in (joint for link in self._links for joint in link.joints):
            values = next((field for field in self.fields if field.name == joint.field), None)
            if values is None or joint.name not in values.items:
                raise DamagedRecording(f"no {joint.field} of the joint {joint.name!r} was recorded")

    def _moved(self, states: dict[str, NDArray[Any]]) -> Iterator[Placed]:
        for field in self._bodies:
            recorded = states[field.name].astype(np.float64)
            position = np.zeros((*recorded.shape[:2], 3))
            position[..., : recorded.shape[-1]] = recorded
            if field.frame == "world":
                position -= self._origin
            turned = self._turned(field)
            orientation = np.broadcast_to(np.array(IDENTITY), (*recorded.shape[:2], 4))
            if turned is not None:
                orientation = states[turned.name].astype(np.float64)
            for item in range(len(field.items)):
                yield position[:, item], orientation[:, item]

    def _hung(self, states: dict[str, NDArray[Any]]) -> Iterator[Placed]:
        n_row = len(next(iter(states.values()))) if states else 0
        values = {name: array.astype(np.float64) for name, array in states.items()} if self._links else {}
        for link in self._links:
            items = [self._known[joint.field].items.index(joint.name) for joint in link.joints]
            moved = [values[joint.field][:, item] for joint, item in zip(link.joints, items, strict=True)]
            yield link.placed(moved, n_row)


def absolute(frames: Sequence[Frame]) -> list[Placed]:
    """Poses of all frames in the env's frame, in their order."""
    poses: list[Placed] = []
    for frame in frames:
        position, orientation = frame.position, frame.orientation
        if frame.part.parent is not None:
            there, turned = poses[frame.part.parent]
            turned = unit(turned)
            position, orientation = there + rotate(turned, position), product(turned, orientation)
        poses.append((position, orientation))
    return poses


def _of_joints(field: StateField) -> bool:
    return field.width == 1 if field.field == "qpos" else field.components == ("w", "x", "y", "z")


def _parts(free: Sequence[MovingPart], links: Sequence[Link]) -> Iterator[MovingPart]:
    yield from free
    known: dict[Key | None, int | None] = {None: None, **{(p.group, p.name): at for at, p in enumerate(free)}}
    for at, link in enumerate(links, len(free)):
        if link.parent not in known:
            raise DamagedRecording(f"no pose of the body that {link.name!r} hangs on was recorded")
        yield MovingPart(link.name, ROBOT, known[link.parent])
        known[ROBOT, link.name] = at
