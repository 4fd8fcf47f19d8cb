"""Where joints are at the sample step, by unit: hinges and ball joints turn [rad], slides move [m]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.joints import JointSpace
from gpusimbench.evaluator.metrics.variability import sampling_step
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.outcome import joint_fields
from gpusimbench.evaluator.runs.positions import no_states
from gpusimbench.schemas.fields import StateField

NO_JOINTS = Missing('no joints were recorded (needs a group with the field "qpos", or ball joints with "orientation")')

_ROUND = 1e-3  # by which the length of a quaternion may differ from 1


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
