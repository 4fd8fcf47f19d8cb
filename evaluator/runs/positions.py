"""The outcome of a recording: the free bodies whose positions W1 compares, and the joints; and where all of them are at
the sample step.

No name of a group means anything here. The free bodies of the outcome are, in this order:

1. the groups that the scene declares, a list of names under "outcome" in scene.json;
2. where the scene names a board, the groups whose bodies all begin over its rectangle, by the positions in scene.json:
   of inclined-collision the cubes, and not the ball, which begins on the slope beside the board. Boards and first
   positions are in files of all versions, so that old files are evaluated by the same rule;
3. all groups that have positions.

What is of no recorded group, and what has no positions, is not there to be chosen. Groups without positions that have
"qpos", or orientations alone, are joints.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.joints import JointSpace
from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.failing import ONLY_FAILING
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import board_of
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, damage_in
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import REAL

NO_BODIES = Missing('no positions of free bodies were recorded (W1 needs a group with the field "position")')

NO_JOINTS = Missing('no joints were recorded (needs a group with the field "qpos", or ball joints with "orientation")')
_ROUND = 1e-3  # by which the length of a quaternion may differ from 1
_FAR_M = 1e6  # a body that far away belongs to a simulation that blew up


def outcome_of(recording: Recording) -> tuple[StateField, ...] | Missing:
    """Positions of the bodies that the outcome is, a field a group, or the reason why there are none.

    DamagedRecording where what the scene declares is unreadable.
    """
    fields = positional(recording.fields)
    if not fields:
        return NO_BODIES
    if declared := declared_outcome(recording):
        chosen = tuple(field for field in fields if field.group in declared)
        if not chosen:
            names = ", ".join(declared)
            return Missing(f"no positions of {names} were recorded, which the scene declares as its outcome")
        return _alike(chosen)
    over = _over_board(recording)
    return _alike(tuple(field for field in fields if field.group in over) or fields)


def declared_outcome(recording: Recording) -> tuple[str, ...]:
    """Names of the groups that scene.json declares as the outcome; empty where it declares none."""
    with damage_in(f"{recording.path}: scene.json"):
        return checks.texts(recording.scene, "outcome")


def positional(fields: Sequence[StateField]) -> tuple[StateField, ...]:
    """The fields that tell where free bodies are."""
    return tuple(field for field in fields if field.field == "position" and field.items)


def joint_fields(fields: Sequence[StateField]) -> tuple[StateField, ...]:
    """The fields that tell where joints are: "qpos" of hinges and slides, "orientation" of ball joints."""
    bodies = {field.group for field in positional(fields)}
    return tuple(
        field
        for field in fields
        if (field.field == "qpos" and field.width == 1)
        or (field.field == "orientation" and field.width == 4 and field.group not in bodies)
    )


def _alike(fields: tuple[StateField, ...]) -> tuple[StateField, ...] | Missing:
    layouts = {(field.dtype, field.frame, field.components) for field in fields}
    if len(layouts) == 1:
        return fields
    names = ", ".join(field.group for field in fields)
    return Missing(
        f"the groups {names} record positions in different frames, number types or components, which are not compared "
        'together; "outcome" in scene.json can name those that belong together'
    )


def _over_board(recording: Recording) -> frozenset[str]:
    board = board_of(recording)
    if board is None:
        return frozenset()
    (x, y, _), (length, width, _) = board.centre, board.size
    over: dict[str, bool] = {}
    with damage_in(recording.path):
        for body in checks.objects(recording.scene, "bodies"):
            group = checks.text(body, "group", default="")
            if body.get("mass") is None or not group:
                continue
            at = checks.vector(body.get("position"), 3, "a body's position")
            inside = abs(at[0] - x) <= length / 2 and abs(at[1] - y) <= width / 2
            over[group] = over.get(group, True) and inside
    return frozenset(group for group, inside in over.items() if inside)


class OutcomeArray:
    """Positions of the bodies of an outcome, all groups one behind the other, read when asked for.

    field  the first group's, whose frame and components all have
    steps  simulator step of each row
    """

    def __init__(self, recording: Recording, fields: Sequence[StateField]) -> None:
        self.field = fields[0]
        self._arrays = [recording.state(field.group, field.field) for field in fields]
        rows = min(map(len, self._arrays))
        self.steps = self._arrays[0].steps[:rows]

    def __len__(self) -> int:
        return len(self.steps)

    def at_step(self, step: int) -> NDArray[Any]:
        """As recorded at a simulator step [m], [env, item, component]; KeyError where the step was not recorded."""
        return _joined([array.at_step(step) for array in self._arrays])

    def read(self, rows: slice) -> NDArray[Any]:
        """Some rows as recorded [m], [step, env, item, component]."""
        return _joined([array.read(rows, slice(None)) for array in self._arrays])


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-2)


def no_states(recording: Recording) -> Missing:
    """Why a recording has no states."""
    if recording.configuration.keep:
        return Missing(ONLY_FAILING)
    return Missing("no states were recorded (the capture phase was left out or not reached)")


@dataclass(frozen=True)
class Positions:
    """Positions of the bodies of the outcome at the sample step, kept as recorded: half of what they take in float64.

    recorded  as recorded [m], [env, item, component]
    origins   to be subtracted [m], [env, component]; None where the coordinates are relative to them already
    time      simulated time that was sampled [s]
    """

    recorded: NDArray[Any]
    origins: NDArray[np.float64] | None
    time: float

    @property
    def local(self) -> NDArray[np.float64]:
        """Positions in each env's own frame, float64 [m], [env, item, component]."""
        local = self.recorded.astype(np.float64)
        return local if self.origins is None else local - self.origins[:, None, :]

    @property
    def planar(self) -> NDArray[np.float64]:
        """x and y in each env's own frame, float64 [m], [env, item, 2]."""
        return self.local[..., :2]

    @property
    def spatial(self) -> NDArray[np.float64] | None:
        """x, y and z likewise [m], [env, item, 3]; None where heights were not recorded."""
        return self.local if self.recorded.shape[-1] == 3 else None


def sample_positions(recording: Recording, sample_time: float) -> Positions | Missing:
    """Positions at step round(sample_time / dt), or the reason why there are none; see evaluator.runs.outcome.

    Origins are subtracted behind the recording, in float64, from coordinates of the world frame: before it, that would
    have cost bits. Coordinates that are declared relative to the env's origin already are left as they are.
    """
    fields = outcome_of(recording)
    if isinstance(fields, Missing):
        return fields
    array = OutcomeArray(recording, fields)
    if not len(array):
        return no_states(recording)
    dt = recording.configuration.dt
    step = sampling_step(sample_time, dt)
    if recording.configuration.simulator == REAL and not math.isclose(step * dt, sample_time, rel_tol=1e-6):
        return Missing(f"the trials were measured at {dt:g} s, not at {sample_time:g} s")
    try:
        recorded = array.at_step(step)
    except KeyError:
        last = array.steps[-1]
        return Missing(
            f"step {step} ({sample_time:g} s) was not recorded; recorded are steps {array.steps[0]} to {last} "
            f"({last * dt:g} s)"
        )
    positions = Positions(recorded, _origins(recording, array.field), step * dt)
    planar = positions.planar
    if not np.isfinite(positions.recorded).all():
        return Missing("positions at the sample step are not finite")
    if np.abs(planar).max() > _FAR_M:
        return Missing(f"positions at the sample step are beyond {_FAR_M / 1000:g} km: the simulation blew up")
    return positions


def in_env_frame(
    recording: Recording, field: StateField, recorded: NDArray[Any], envs: slice = slice(None)
) -> NDArray[np.float64]:
    """Positions [..., env, item, component] in each env's own frame [m], float64; DamagedRecording where they are none.

    envs  that the positions are of
    """
    origins = _origins(recording, field)
    local = recorded.astype(np.float64)
    return local if origins is None else local - origins[envs, None, :]


def check_format(recording: Recording, field: StateField) -> None:
    """DamagedRecording where a field of positions has another unit, frame or other components than the format has."""
    if field.unit != "m" or field.frame not in ("world", "env"):
        raise DamagedRecording(
            f"{recording.path}: {field.name} is in {field.unit}, frame {field.frame}: not of this format"
        )
    if field.components not in (("x", "y"), ("x", "y", "z")):
        raise DamagedRecording(f"{recording.path}: {field.name} has the components {', '.join(field.components)}")


def _origins(recording: Recording, field: StateField) -> NDArray[np.float64] | None:
    """What is to be subtracted from a field of positions [m], [env, component]."""
    check_format(recording, field)
    origins = recording.simulation.env_origins if recording.simulation else ()
    if not origins or field.frame != "world":
        return None
    return np.array(origins, dtype=np.float64)[:, : len(field.components)]


@dataclass(frozen=True)
class Joints:
    """Joints of one unit at the sample step.

    names  group and name of each, hinges or slides before ball joints
    space  their coordinates
    """

    names: tuple[tuple[str, str], ...]
    space: JointSpace


@dataclass(frozen=True)
class JointSample:
    """All joints of a run at the sample step.

    turning  hinges and ball joints [rad], or why there is none
    sliding  slides [m], or why there is none
    """

    turning: Joints | Missing
    sliding: Joints | Missing

    @property
    def any(self) -> bool:
        """Whether there is a joint of either kind."""
        return not (isinstance(self.turning, Missing) and isinstance(self.sliding, Missing))


def sample_joints(recording: Recording, sample_time: float) -> JointSample:
    """The joints at step round(sample_time / dt), or the reasons why there are none."""
    fields = joint_fields(recording.fields)
    if not fields:
        return JointSample(NO_JOINTS, NO_JOINTS)
    step = sampling_step(sample_time, recording.configuration.dt)
    read: dict[str, NDArray[Any]] = {}
    for field in fields:
        array = recording.state(field.group, field.field)
        if not len(array):
            return JointSample(no_states(recording), no_states(recording))
        try:
            read[field.name] = array.at_step(step).astype(np.float64)
        except KeyError:
            why = Missing(f"step {step} ({sample_time:g} s) was not recorded")
            return JointSample(why, why)
    return JointSample(_turning(fields, read), _sliding(fields, read))


def _turning(fields: Sequence[StateField], read: dict[str, NDArray[Any]]) -> Joints | Missing:
    balls = [field for field in fields if field.field == "orientation"]
    hinges, angles = _of_unit(fields, read, "rad")
    if not hinges and not balls:
        return Missing(f"no joint turns: those that were recorded are in {_units(fields)}")
    quaternions = (
        np.concatenate([read[field.name] for field in balls], axis=1) if balls else np.zeros((len(angles), 0, 4))
    )
    if balls and not (np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0) <= _ROUND).all():
        return Missing("orientations of ball joints at the sample step are no unit quaternions")
    names = (*hinges, *((field.group, name) for field in balls for name in field.items))
    return _finite(names, JointSpace(angles, quaternions))


def _sliding(fields: Sequence[StateField], read: dict[str, NDArray[Any]]) -> Joints | Missing:
    slides, travel = _of_unit(fields, read, "m")
    if not slides:
        return Missing(f"no joint slides: those that were recorded are in {_units(fields)}")
    return _finite(slides, JointSpace(travel, np.zeros((len(travel), 0, 4))))


def _of_unit(
    fields: Sequence[StateField], read: dict[str, NDArray[Any]], unit: str
) -> tuple[tuple[tuple[str, str], ...], NDArray[np.float64]]:
    names: list[tuple[str, str]] = []
    columns = []
    for field in fields:
        if field.field != "qpos":
            continue
        for item, (name, of_item) in enumerate(zip(field.items, field.units, strict=True)):
            if of_item == unit:
                names.append((field.group, name))
                columns.append(read[field.name][:, item, 0])
    n_env = len(next(iter(read.values())))
    return tuple(names), np.stack(columns, axis=1) if columns else np.zeros((n_env, 0))


def _units(fields: Sequence[StateField]) -> str:
    return ", ".join(dict.fromkeys(unit for field in fields for unit in field.units))


def _finite(names: tuple[tuple[str, str], ...], space: JointSpace) -> Joints | Missing:
    if not (np.isfinite(space.coordinates).all() and np.isfinite(space.balls).all()):
        return Missing("joint coordinates at the sample step are not finite")
    return Joints(names, space)
