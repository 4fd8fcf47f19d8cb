"""The whole motion of a canonical scene, as far as its laws need it: read at once, bounded, and finite."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.states import States, Walk, drawn_envs
from gpusimbench.evaluator.runs.physics.world import World, world_of
from gpusimbench.evaluator.statistics.cases import variation

Array = npt.NDArray[np.float64]

_MOST_NUMBERS = 4_000_000  # rows times environments times bodies or joints: of more, nothing is looked at
_BLOWN = 1e9  # in any SI unit

_FEW = Missing("fewer than two states were recorded")
_MANY = Missing(f"more than {_MOST_NUMBERS:,} states of bodies or joints were recorded")
_NOT_FINITE = Missing("states are not finite")


def joints_of(recording: Recording) -> tuple[Array, Array, Array] | Missing:
    """Time [row], angles and speeds of the robot's joints [row, env, joint], of environments that are looked at."""
    kinds = {field.field for field in recording.fields if field.group == "robot"}
    if not {"qpos", "qvel"} <= kinds:
        return Missing("angles and velocities of joints were not both recorded")
    angles, speeds = (recording.state("robot", field) for field in ("qpos", "qvel"))
    if len(angles) < 2 or len(speeds) != len(angles):
        return _FEW
    if len(angles) * _count(recording) * len(angles.field.items) > _MOST_NUMBERS:
        return _MANY
    angle, speed = (
        np.concatenate(
            [array.read(slice(None), slice(first, last + 1))[..., 0] for first, last in _drawn(recording)], axis=1
        ).astype(np.float64)
        for array in (angles, speeds)
    )
    if not finite(angle, speed):
        return _NOT_FINITE
    return angles.steps[:].astype(np.float64) * recording.configuration.dt, angle, speed


def shaped(recording: Recording) -> tuple[World, States, Array] | Missing:
    """World, states and time, as `bodies_of` returns them; Missing also if a body is neither a ball nor a cube."""
    read = bodies_of(recording)
    if isinstance(read, Missing):
        return read
    walk, states, time = read
    world = world_of(recording, walk.items)
    return world if isinstance(world, Missing) else (world, states, time)


def bodies_of(recording: Recording) -> tuple[Walk, States, Array] | Missing:
    """Names, states and time [row] since the first, of moving bodies in environments that are looked at."""
    walk = Walk(recording, _drawn(recording))
    if len(walk) > 1 and len(walk) * _count(recording) * len(walk.items) > _MOST_NUMBERS:
        return _MANY
    states = _states(walk, 0)
    if isinstance(states, Missing):
        return states
    return walk, states, (states.step - states.step[0]) * recording.configuration.dt


def ending_of(recording: Recording) -> tuple[Walk, States] | Missing:
    """Names and last state of the moving bodies in all environments, or, of very many, in those that are looked at."""
    walk = Walk(recording, ((0, recording.configuration.n_env - 1),))
    if recording.configuration.n_env * len(walk.items) > _MOST_NUMBERS:
        walk = Walk(recording, _drawn(recording))
    states = _states(walk, len(walk) - 1)
    return states if isinstance(states, Missing) else (walk, states)


def _states(walk: Walk, first: int) -> States | Missing:
    if not walk.groups:
        return Missing("no positions in three dimensions were recorded")
    if len(walk) < 2:
        return _FEW
    states = walk.rows(first, len(walk))
    parts = (states.position, states.orientation, states.linear, states.angular)
    return states if finite(*(part for part in parts if part is not None)) else _NOT_FINITE


def finite(*arrays: Array) -> bool:
    """Whether every number is one of a motion."""
    return all(bool((np.abs(array) <= _BLOWN).all()) for array in arrays)


def cycles(time: Array, value: Array) -> tuple[float, int]:
    """Period between the first and the last passage upward through zero [s], and the number of periods between them;
    NaN and 0 with fewer than two passages.

    time, value  [row]
    """
    at = np.nonzero((value[:-1] < 0.0) & (value[1:] >= 0.0))[0]
    if len(at) < 2:
        return math.nan, 0
    first, last = (float(time[i] - value[i] * (time[i + 1] - time[i]) / (value[i + 1] - value[i])) for i in at[[0, -1]])
    return (last - first) / (len(at) - 1), len(at) - 1


def fewest_periods(found: Iterable[tuple[float, int]]) -> int:
    """Of what `cycles` found in environments, the smallest number of periods above zero; 1 where there is none."""
    return min((count for _, count in found if count), default=1)


def unevenness(effects: Array) -> float:
    """How unevenly a change of a parameter moves environments, from the derivative of each [env]: the coefficient of
    variation; infinite where some move up and others down, since the mean then says little of them."""
    return math.inf if (effects < 0.0).any() and (effects > 0.0).any() else variation(effects)


def _drawn(recording: Recording) -> tuple[tuple[int, int], ...]:
    return drawn_envs(recording.configuration.n_env)


def _count(recording: Recording) -> int:
    return sum(last - first + 1 for first, last in _drawn(recording))
