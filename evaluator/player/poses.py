"""Where the bodies and links of an environment are, all in its own frame; the one module that knows who reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.configuration import sim_time_ns
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.view.geometry import Shape
from gpusimbench.schemas.view.kinematics import ROBOT
from gpusimbench.schemas.view.motion import Frame, Motion, absolute

_PIECE_ROWS = 4096  # read at once, so that memory does not grow with the length of a run
_MOST_SHAPES = 4000  # that are drawn in every picture
_LAST_NS = 1 << 62
_FLAT_M = 1e-3  # a thinner box is the ground

__all__ = ["Items", "Shape", "Surroundings", "items_of", "recorded_steps", "surroundings"]


@dataclass(frozen=True)
class Items:
    """What moves in an environment.

    bodies       group and name of each item
    position     shape [row, item, 3] [m], in the env's frame
    orientation  shape [row, item, 4], wxyz
    """

    bodies: tuple[tuple[str, str], ...]
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]


@dataclass(frozen=True)
class Surroundings:
    """What a recording's scene looks like.

    fixed   shapes of the world, in the env's frame
    ground  those of them that are flat: planes
    bodies  shapes of what moves, by group and name; a link may have none
    left_out  how many shapes more the scene has than are drawn
    """

    fixed: tuple[Shape, ...]
    ground: tuple[Shape, ...]
    bodies: dict[tuple[str, str], tuple[Shape, ...]]
    left_out: int


def recorded_steps(recording: Recording) -> NDArray[np.int64]:
    """Simulator steps of the rows that can be shown, shape [row]; empty where no state of a body or joint is there.

    DamagedRecording where fields or steps are not of the format.
    """
    arrays = [recording.state(field.group, field.field) for field in _motion(recording, 0).fields]
    stop = min(map(len, arrays), default=0)
    steps = np.asarray(arrays[0].steps[:stop], dtype=np.int64) if stop else np.empty(0, dtype=np.int64)
    if len(steps) and sim_time_ns(int(steps[-1]), recording.configuration.dt) > _LAST_NS:
        raise DamagedRecording(f"{recording.path}: step {steps[-1]} is later than a run lasts")
    return steps


def nothing_shown(recording: Recording) -> str:
    """Why a recording without steps to show has none: a clause behind its name."""
    if recording.failing is not None:
        return "holds the last states of failing environments alone (--keep failing); gsb-info lists these environments"
    captured = any(len(recording.state(field.group, field.field)) for field in recording.fields)
    if not captured or _motion(recording, 0).fields:
        return "holds no states of bodies or joints; there is nothing to show"
    if all(field.group == ENV for field in recording.fields):
        return "holds observations and actions of a task, and no positions of bodies; there is nothing to draw"
    groups = ", ".join(dict.fromkeys(field.group for field in recording.fields))
    return f"holds states of {groups}, of which no place follows: scene.json describes no robot that they move"


def hidden_groups(recording: Recording) -> list[str]:
    """Groups of which nothing is shown: they have no positions, and no robot or model that their joints move."""
    shown = {field.group for field in _motion(recording, 0).fields}
    return [group for group in dict.fromkeys(f.group for f in recording.fields) if group not in shown]


def items_of(recording: Recording, env: int, rows: Sequence[range]) -> Items:
    """The items of an environment at some rows, range after range.

    DamagedRecording where fields are not of the format.
    """
    motion = _motion(recording, env)
    parts = [
        _items(_frames(recording, motion, env, slice(begin, min(r.stop, begin + size), r.step)))
        for r in rows
        for size in (r.step * max(1, _PIECE_ROWS // r.step),)
        for begin in range(r.start, r.stop, size)
    ]
    return Items(
        parts[0].bodies,
        np.concatenate([p.position for p in parts]), np.concatenate([p.orientation for p in parts]),
    )  # fmt: skip


def surroundings(recording: Recording) -> Surroundings:
    """Shapes from the recording's scene; DamagedRecording where one is unreadable."""
    solids = recording.look.solids
    ends = np.cumsum([len(solid.shapes) for solid in solids], dtype=np.int64)
    left_out = int(ends[-1]) if len(ends) else 0
    solids = solids[: int(np.searchsorted(ends, _MOST_SHAPES, side="right"))]
    left_out -= sum(len(solid.shapes) for solid in solids)
    fixed = [shape for solid in solids if not solid.group for shape in solid.shapes]
    ground = tuple(s for s in fixed if s.kind == "box" and min(s.size) < _FLAT_M)
    return Surroundings(
        tuple(s for s in fixed if s not in ground),
        ground,
        {(s.group, s.name): s.shapes for s in solids if s.group and (s.shapes or s.group == ROBOT)},
        left_out,
    )


def _motion(recording: Recording, env: int) -> Motion:
    origins = recording.simulation.env_origins if recording.simulation else ()
    try:
        return Motion(recording.fields, recording.look, origin=origins[env] if origins else (0.0, 0.0, 0.0))
    except DamagedRecording as error:
        raise _with_path(recording, error) from None


def _frames(recording: Recording, motion: Motion, env: int, rows: slice) -> tuple[Frame, ...]:
    return motion.frames([recording.state(field.group, field.field)[rows, env] for field in motion.fields])


def _with_path(recording: Recording, error: DamagedRecording) -> DamagedRecording:
    """The error, with the path of the recording before its text."""
    return DamagedRecording(f"{recording.path}: {str(error).removeprefix(f'{recording.path}: ')}")


def _items(frames: Sequence[Frame]) -> Items:
    if not frames:
        return Items((), np.empty((0, 0, 3)), np.empty((0, 0, 4)))
    position, orientation = (np.stack(arrays, axis=1) for arrays in zip(*absolute(frames), strict=True))
    return Items(tuple((frame.part.group, frame.part.name) for frame in frames), position, orientation)
