"""How the bodies and links of one environment move, as frames over rows of its states."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.view.rotation import about_z, product
from gpusimbench.schemas.view.shapes import IDENTITY, Link, links_of

ROBOT = "robot"


class Part(NamedTuple):
    """What moves.

    name    of the body or link
    group   that it belongs to
    parent  name of the link that it is relative to; empty for the env's frame
    """

    name: str
    group: str
    parent: str


@dataclass(frozen=True)
class Frame:
    """A body or link over some rows.

    position     [row, 3] [m]
    orientation  [row, 4], wxyz
    """

    part: Part
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]


def one_of(rate: float, *, dt: float, stride: int) -> int:
    """Of how many recorded rows one is shown, so that at most `rate` are shown in a simulated second."""
    return max(1, math.ceil(1 / (rate * dt * stride) - 1e-9))


class Motion:
    """Frames from the states of an environment.

    fields  whose states are needed, in this order
    parts   that move, links after their parents; empty where nothing of the state is a place

    origin  of the environment in the engine's world frame [m]; frames are relative to it

    DamagedRecording where fields or the scene are not of the format.
    """

    def __init__(
        self, fields: Sequence[StateField], scene: dict[str, Any], *, origin: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> None:
        self._origin = np.array(origin, dtype=np.float64)
        self._known = {field.name: field for field in fields}
        self._bodies = [field for field in fields if field.field == "position"]
        self._joints = self._known.get(f"{ROBOT}/qpos")
        self._links = links_of(scene) if self._joints is not None and self._joints.width == 1 else ()
        self._check()
        turned = [f for f in map(self._turned, self._bodies) if f is not None]
        robot = [self._joints] if self._joints is not None and self._links else []
        self.fields = (*self._bodies, *turned, *robot)
        self.parts = (
            *(Part(name, field.group, "") for field in self._bodies for name in field.items),
            *(Part(link.name, ROBOT, link.parent) for link in self._links),
        )

    def frames(self, states: Sequence[NDArray[Any]]) -> tuple[Frame, ...]:
        """Frames of rows, in the order of `parts`, from an array [row, item, width] of each of `fields`."""
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
        for link in self._links:
            if link.joint and (self._joints is None or link.joint not in self._joints.items):
                raise DamagedRecording(f"no angle of the joint {link.joint!r} was recorded")

    def _moved(self, states: dict[str, NDArray[Any]]) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
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

    def _hung(self, states: dict[str, NDArray[Any]]) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        if self._joints is None or not self._links:
            return
        angles = states[self._joints.name][..., 0].astype(np.float64)
        for link in self._links:
            yield np.broadcast_to(np.array(link.position), (len(angles), 3)), self._turn(link, angles)

    def _turn(self, link: Link, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        at_zero = np.broadcast_to(np.array(link.orientation), (len(angles), 4))
        if not link.joint or self._joints is None:
            return at_zero
        return product(at_zero, about_z(angles[:, self._joints.items.index(link.joint)]))
