"""Where the bodies of the outcome are at the sample step, and their joints, as every positional metric needs it."""

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
from gpusimbench.evaluator.runs.outcome import OutcomeArray, joint_fields, outcome_of
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import REAL

NO_JOINTS = Missing('no joints were recorded (needs a group with the field "qpos", or ball joints with "orientation")')

_ROUND = 1e-3  # by which the length of a quaternion may differ from 1


def no_states(recording: Recording) -> Missing:
    """Why a recording has no states."""
    if recording.configuration.keep:
        return Missing(ONLY_FAILING)
    return Missing("no states were recorded (the capture phase was left out or not reached)")


_FAR_M = 1e6  # a body that far away belongs to a simulation that blew up


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
