"""How the bodies and links of one environment move, as frames over time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.recording import Recording
from evaluator.sharing.rotation import about_z, product
from evaluator.sharing.shapes import IDENTITY, links_of
from schemas.configuration import sim_time_ns
from schemas.errors import DamagedRecording
from schemas.fields import StateField

ROBOT = "robot"

_LAST_NS = 1 << 62


@dataclass(frozen=True)
class Frame:
    """A body or link over time.

    name         of the body or link
    group        that it belongs to
    parent       name of the link that it is relative to; empty for the env's frame
    position     [row, 3] [m]
    orientation  [row, 4], wxyz
    """

    name: str
    group: str
    parent: str
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]


@dataclass(frozen=True)
class Rows:
    """Which rows are shown.

    every    one of so many recorded rows
    stop     behind the last row that every field has
    times    simulated time of each shown row [ns]
    """

    every: int
    stop: int
    times: tuple[int, ...]

    @property
    def picked(self) -> slice:
        """The rows as an index."""
        return slice(0, self.stop, self.every)


def rows_at(recording: Recording, rate: float) -> Rows:
    """Rows at most `rate` times a simulated second; none where a field has none."""
    arrays = [recording.state(field.group, field.field) for field in recording.fields if _shown(field)]
    stop = min((len(array) for array in arrays), default=0)
    dt, stride = recording.configuration.dt, recording.configuration.stride
    every = max(1, math.ceil(1 / (rate * dt * stride) - 1e-9))
    steps = arrays[0].steps[:stop:every] if stop else ()
    times = tuple(sim_time_ns(int(step), dt) for step in steps)
    if times and times[-1] > _LAST_NS:
        raise DamagedRecording(f"{recording.path}: {times[-1]} ns is no time that a run lasts")
    return Rows(every, stop, times)


def frames_of(recording: Recording, env: int, rows: Rows) -> tuple[Frame, ...]:
    """The frames of an environment, links after their parents; DamagedRecording where fields are not of the format."""
    bodies = [frame for f in recording.fields if f.field == "position" for frame in _bodies(recording, f, env, rows)]
    return (*bodies, *_links(recording, env, rows))


def _shown(field: StateField) -> bool:
    return field.field in ("position", "orientation") or (field.group, field.field) == (ROBOT, "qpos")


def _bodies(recording: Recording, field: StateField, env: int, rows: Rows) -> list[Frame]:
    if field.frame not in ("world", "env") or field.components not in (("x", "y"), ("x", "y", "z")):
        raise DamagedRecording(f"{recording.path}: {field.name} has a frame or components that are not of this format")
    recorded = recording.state(field.group, "position")[rows.picked, env].astype(np.float64)
    position = np.zeros((*recorded.shape[:2], 3))
    position[..., : recorded.shape[-1]] = recorded
    origins = recording.simulation.env_origins if recording.simulation else ()
    if origins and field.frame == "world":
        position -= np.array(origins[env])
    orientation = np.broadcast_to(np.array(IDENTITY), (*recorded.shape[:2], 4))
    turned = next((f for f in recording.fields if (f.group, f.field) == (field.group, "orientation")), None)
    if turned is not None:
        if turned.components != ("w", "x", "y", "z") or turned.items != field.items:
            raise DamagedRecording(f"{recording.path}: {turned.name} is not of this format")
        orientation = recording.state(field.group, "orientation")[rows.picked, env].astype(np.float64)
    return [
        Frame(name, field.group, "", position[:, item], orientation[:, item]) for item, name in enumerate(field.items)
    ]


def _links(recording: Recording, env: int, rows: Rows) -> list[Frame]:
    field = next((f for f in recording.fields if (f.group, f.field) == (ROBOT, "qpos")), None)
    if field is None or field.width != 1:
        return []
    angles = recording.state(ROBOT, "qpos")[rows.picked, env, :, 0].astype(np.float64)
    frames = []
    for link in links_of(recording):
        orientation = np.broadcast_to(np.array(link.orientation), (len(angles), 4))
        if link.joint:
            if link.joint not in field.items:
                raise DamagedRecording(f"{recording.path}: no angle of the joint {link.joint!r} was recorded")
            orientation = product(orientation, about_z(angles[:, field.items.index(link.joint)]))
        position = np.broadcast_to(np.array(link.position), (len(angles), 3))
        frames.append(Frame(link.name, ROBOT, link.parent, position, orientation))
    return frames
