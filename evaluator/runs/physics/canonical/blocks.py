"""The laws of the scene sliding-block: accelerations, stopping distances and creep, by Coulomb's law of friction."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.closed_form import sliding_acceleration, stopping_distance
from gpusimbench.evaluator.metrics.physics.solids import rotations
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import shaped
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.evaluator.runs.physics.world import Moving

Array = npt.NDArray[np.float64]

_SETTLED = 0.1  # until when soft contacts come to bear [s]
_SLOW = 0.1  # share of a block's speed at which it is no longer looked at, lest it stop within a step
_STILL = 0.01  # share of it at which it has stopped
_FEWEST = 5  # rows of a fit


def block_laws(recording: Recording) -> tuple[LawValues, ...] | Missing:
    """The laws, or why none can be measured."""
    read = shaped(recording)
    if isinstance(read, Missing):
        return read
    world, states, time = read
    if states.linear is None or states.orientation is None:
        return Missing("velocities and orientations of the blocks were not both recorded")
    if int(np.searchsorted(time, _SETTLED)) + _FEWEST >= len(time):
        return Missing(f"fewer than {_FEWEST + 1} states were recorded after {_SETTLED:g} s")
    found: list[LawValues] = []
    for index, block in enumerate(world.moving):
        turn = rotations(states.orientation[:1, :1, index])[0, 0]
        way = states.position[:, :, index] @ turn[:, 0]
        speed = states.linear[:, :, index] @ turn[:, 0]
        found += _block(block, turn, time, way, speed, gravity=world.gravity, dt=recording.configuration.dt)
    return tuple(found)


def _block(
    block: Moving, turn: Array, time: Array, way: Array, speed: Array, *, gravity: float, dt: float
) -> list[LawValues]:
    """The laws of one block: its place along the plank and its speed [row, env], from its own first orientation."""
    friction = block.surface.kinetic
    downhill, normal = -float(turn[2, 0]), float(turn[2, 2])
    degrees = f"on {round(math.degrees(math.asin(downhill)), 3) + 0.0:g} degrees"
    predicted = sliding_acceleration(downhill, normal, gravity, friction)
    share = -gravity * normal * friction  # derivative of the acceleration, for a share of 1 of the friction
    settled = int(np.searchsorted(time, _SETTLED))
    envs = range(way.shape[1])
    if block.rests and predicted < 0.0:
        crept = tuple(float(way[-1, env] - way[settled, env]) for env in envs)
        none = (("mass", 0.0), ("friction", 0.0))
        title = f"creep of the block that sticks {degrees}"
        return [
            LawValues(f"{block.name}_creep", title, "m", crept, (0.0,) * len(crept), gravity * dt**2, "g dt^2", none)
        ]
    fits = [_fit(time, speed[:, env], settled) for env in envs]
    shortest = min((duration for _, duration in fits if duration), default=time[-1])
    made = LawValues(
        f"{block.name}_acceleration", f"acceleration of the block {degrees}", "m/s2",
        tuple(value for value, _ in fits), (predicted,) * len(fits),
        abs(predicted) * dt / shortest, "a dt / T", (("mass", 0.0), ("friction", share)),
        f"the block slides in fewer than {_FEWEST} states",
    )  # fmt: skip
    if predicted >= 0.0:
        return [made]
    begun = speed[settled]
    expected = stopping_distance(begun, predicted)
    stopped = np.abs(speed[-1]) < _STILL * np.abs(begun)
    went = np.where(stopped & (begun > 0.0), way[-1] - way[settled], np.nan)
    longer = float(np.nanmean(np.where(np.isfinite(went), expected, np.nan))) if np.isfinite(went).any() else 0.0
    return [
        made,
        LawValues(
            f"{block.name}_distance", f"stopping distance {degrees}", "m", tuple(map(float, went)),
            tuple(map(float, expected)), float(np.abs(begun).max()) * dt, "v dt",
            (("mass", 0.0), ("friction", -longer * share / predicted)), "the block did not stop",
        ),
    ]  # fmt: skip


def _fit(time: Array, speed: Array, settled: int) -> tuple[float, float]:
    """Slope of the speed while the block slides [m/s2], and for how long [s]; NaN and 0 where it hardly does."""
    slow = np.nonzero(speed[settled:] < _SLOW * speed[0])[0] if speed[0] > 0.0 else np.zeros(0, dtype=int)
    stop = settled + int(slow[0]) if len(slow) else len(speed)
    if stop - settled < _FEWEST:
        return math.nan, 0.0
    window = slice(settled, stop)
    return float(np.polyfit(time[window], speed[window], 1)[0]), float(time[stop - 1] - time[settled])
