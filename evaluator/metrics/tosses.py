"""Errors of simulated motions of one thrown cube against measured ones.

All of them are computed toss by toss, over the rows that were measured of that toss, and none of them needs the
simulations to be in the order of the measurements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.physics.solids import length, rotations

Floats = NDArray[np.float64]

STILL_SPEED = 0.03
"""A cube is at rest while it moves more slowly than this [m/s] ..."""

STILL_TURN = 0.3
"""... and turns more slowly than this [rad/s]."""


@dataclass(frozen=True)
class Motion:
    """Motions of one cube in many environments, at the same times.

    rows              number of the measured row that each entry is at, ascending, from 0, shape [time]
    position          of the centre [m], world frame, z up, table at z = 0, shape [time, env, 3]
    orientation       unit quaternions wxyz, body to world, shape [time, env, 4]
    linear_velocity   [m/s], world frame, shape [time, env, 3]
    angular_velocity  [rad/s], world frame, shape [time, env, 3]
    """

    rows: NDArray[np.int64]
    position: Floats
    orientation: Floats
    linear_velocity: Floats
    angular_velocity: Floats


@dataclass(frozen=True)
class TossErrors:
    """Errors of each toss, in the order of the measured ones, shape [toss].

    position      distance between the centres, mean over the rows after the first [m]
    rotation      angle between the orientations, mean over the same rows [rad]
    end_position  distance at the last row [m]
    end_rotation  angle at the last row [rad]
    end_face      1 where the same face is up at the last row, else 0
    rest_time     first time from which on the cube is at rest, less the measured one [s]; where the cube is not at rest
                  at the last row, the time of that row stands for it, which is a lower bound
    energy        difference of the mechanical energies, absolute, mean over the same rows [J]
    depth         deepest place of a corner below the table at any of the rows [m]
    numbers       of the tosses in their set, ascending; empty where these are all of it
    """

    position: Floats
    rotation: Floats
    end_position: Floats
    end_rotation: Floats
    end_face: Floats
    rest_time: Floats
    energy: Floats
    depth: Floats
    numbers: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))


@dataclass(frozen=True)
class TrackingFloor:
    """What no simulation can go below, from the measured tosses alone: errors of a body in free fall.

    It begins in the measured first state, falls with the gravity of the scene and turns at a constant rate, as a cube
    does that nothing touches, and is compared with the measured rows before the first contact. What differs is the
    error of tracking, and of the first velocity.

    position  distance, mean over rows and tosses [m]
    rotation  angle, mean over rows and tosses [rad]
    rows      mean number of rows before the first contact
    tosses    tosses with such rows
    """

    position: float
    rotation: float
    rows: float
    tosses: int


@dataclass(frozen=True)
class LocalErrors:
    """Errors of predictions over a fixed number of rows, each from a measured state (teacher forcing).

    rows      that each prediction goes over
    position  distance between the centres at the end of a prediction, mean over the predictions of a toss [m], shape
              [toss]; NaN of a toss that is too short for one
    rotation  angle between the orientations, the same [rad]
    floor     what no simulation can go below: the same errors of a body in free fall, of predictions that begin and end
              before a corner is within 5 mm of the table
    """

    rows: int
    position: Floats
    rotation: Floats
    floor: TrackingFloor


@dataclass(frozen=True)
class Cube:
    """The cube and where it falls: edge [m], mass [kg], moment of inertia about any axis [kg m2], gravity [m/s2]."""

    edge: float
    mass: float
    inertia: float
    gravity: float


def angle(a: Floats, b: Floats) -> Floats:
    """Angle of the rotation between two orientations [rad], shape [...], of unit quaternions [..., 4]."""
    # the sine of half the angle from the difference: the arc cosine of the product loses half of the digits near zero
    nearest = np.minimum(length(a - b), length(a + b))
    return np.asarray(4.0 * np.arcsin(np.clip(nearest / 2.0, 0.0, 1.0)))


def toss_errors(simulated: Motion, measured: Motion, counts: NDArray[np.int64], cube: Cube, dt: float) -> TossErrors:
    """Errors of simulated tosses.

    simulated  at some of the measured rows
    measured   at all rows, of the same tosses in the same order
    counts     measured rows of each toss, shape [toss]
    dt         time between measured rows [s]
    """
    rows = simulated.rows
    real = at_rows(measured, rows)
    within = rows[:, np.newaxis] < counts
    after = within & (rows[:, np.newaxis] > 0)
    last = within.sum(axis=0) - 1
    tosses = np.arange(len(counts))
    distance = length(simulated.position - real.position)
    turned = angle(simulated.orientation, real.orientation)
    energy = np.abs(energies(simulated, cube) - energies(real, cube))
    return TossErrors(
        position=_mean(distance, after),
        rotation=_mean(turned, after),
        end_position=distance[last, tosses],
        end_rotation=turned[last, tosses],
        end_face=(up(simulated.orientation[last, tosses]) == up(real.orientation[last, tosses])).astype(np.float64),
        rest_time=rest_times(simulated, within, dt) - rest_times(real, within, dt),
        energy=_mean(energy, after),
        depth=np.where(within, depths(simulated, cube.edge), 0.0).max(axis=0),
    )


def local_errors(
    simulated: Motion, measured: Motion, counts: NDArray[np.int64], cube: Cube, dt: float, rows: int
) -> LocalErrors:
    """Errors at the ends of predictions over `rows` measured rows.

    simulated  at the rows k `rows`, k = 1, 2, ..., each just before it is set to the measured state there
    measured   at all rows, of the same tosses in the same order
    counts     measured rows of each toss, shape [toss]
    dt         time between measured rows [s]
    """
    ends = simulated.rows
    within = ends[:, np.newaxis] < counts
    real = at_rows(measured, ends)
    some = within.any(axis=0)

    def mean(values: Floats) -> Floats:
        return np.where(some, _mean(values, within), math.nan)

    return LocalErrors(
        rows,
        mean(length(simulated.position - real.position)),
        mean(angle(simulated.orientation, real.orientation)),
        _local_floor(measured, counts, cube, dt, ends, rows),
    )


def _local_floor(
    measured: Motion, counts: NDArray[np.int64], cube: Cube, dt: float, ends: NDArray[np.int64], rows: int
) -> TrackingFloor:
    begins = ends - rows
    touched = np.cumsum(_near_table(measured, cube), axis=0)  # rows so far at which the cube is near the table
    before = np.where(begins[:, np.newaxis] > 0, touched[np.maximum(begins - 1, 0)], 0)
    free = (touched[ends] == before) & (ends[:, np.newaxis] < counts)
    begin, end = at_rows(measured, begins), at_rows(measured, ends)
    time = rows * dt
    fall = np.array([0.0, 0.0, -cube.gravity])
    # a measured velocity is the mean over the interval before its row
    flown = begin.position + (begin.linear_velocity + fall * dt / 2.0) * time + fall * time**2 / 2.0
    turned = _turned(
        begin.orientation.reshape(-1, 4), begin.angular_velocity.reshape(-1, 3), np.array([[time]])
    ).reshape(begin.orientation.shape)
    return _floor(length(flown - end.position), angle(turned, end.orientation), free, float(rows))


def _near_table(measured: Motion, cube: Cube) -> NDArray[np.bool_]:
    # a corner that is within 5 mm of the table may touch it already
    return depths(measured, cube.edge + 0.01) > 0.0


def _floor(distance: Floats, turned: Floats, free: NDArray[np.bool_], rows: float) -> TrackingFloor:
    """Means of errors [time, env] over what flies freely, then over the tosses that do."""
    seen = free.any(axis=0)
    if not seen.any():
        return TrackingFloor(math.nan, math.nan, 0.0, 0)
    return TrackingFloor(
        position=float(_mean(distance, free)[seen].mean()),
        rotation=float(_mean(turned, free)[seen].mean()),
        rows=rows,
        tosses=int(seen.sum()),
    )


def at_rows(motion: Motion, rows: NDArray[np.int64]) -> Motion:
    """A motion of which all rows are known, at some of them."""
    return Motion(
        rows,
        motion.position[rows],
        motion.orientation[rows],
        motion.linear_velocity[rows],
        motion.angular_velocity[rows],
    )


def up(orientation: Floats) -> NDArray[np.int64]:
    """Which face is up, 0 to 5, shape [...], of unit quaternions [..., 4]: of +x, +y, +z, -x, -y, -z of the body."""
    vertical = rotations(orientation)[..., 2, :]  # the world's z in the body's axes
    return np.asarray(np.concatenate([vertical, -vertical], axis=-1).argmax(axis=-1))


def energies(motion: Motion, cube: Cube) -> Floats:
    """Mechanical energy [J], shape [time, env]: of height, of the centre's speed, of turning."""
    squared = (motion.linear_velocity**2).sum(axis=-1), (motion.angular_velocity**2).sum(axis=-1)
    height: Floats = motion.position[..., 2]
    return np.asarray(
        cube.mass * cube.gravity * height + cube.mass * squared[0] / 2.0 + cube.inertia * squared[1] / 2.0
    )


def depths(motion: Motion, edge: float) -> Floats:
    """How far the lowest corner is below the table [m], 0 where it is not, shape [time, env]."""
    reach = np.abs(rotations(motion.orientation)[..., 2, :]).sum(axis=-1) * edge / 2.0
    return np.asarray(np.maximum(reach - motion.position[..., 2], 0.0))


def rest_times(motion: Motion, within: NDArray[np.bool_], dt: float) -> Floats:
    """Time from which on each cube is at rest [s], shape [env]; that of its last row where the cube is not.

    within  which rows belong to which toss, shape [time, env]
    """
    still = (length(motion.linear_velocity) < STILL_SPEED) & (length(motion.angular_velocity) < STILL_TURN)
    moving = within & ~still
    steps = np.arange(len(motion.rows))[:, np.newaxis]
    last_moving = np.where(moving, steps, -1).max(axis=0)
    last = within.sum(axis=0) - 1
    return np.asarray(motion.rows[np.minimum(last_moving + 1, last)] * dt)


def tracking_floor(measured: Motion, counts: NDArray[np.int64], cube: Cube, dt: float, first: Floats) -> TrackingFloor:
    """The floor, of measured tosses at all rows.

    first  linear velocity at the first row [m/s], as simulations are given it, shape [toss, 3]
    """
    time: Floats = (measured.rows * dt)[:, np.newaxis, np.newaxis].astype(np.float64)
    fall = np.array([0.0, 0.0, -cube.gravity])
    flown = measured.position[0] + first * time + fall * time**2 / 2.0
    turned = _turned(measured.orientation[0], measured.angular_velocity[0], np.asarray(time[..., 0]))
    free = (np.cumsum(_near_table(measured, cube), axis=0) == 0) & (measured.rows[:, np.newaxis] < counts)
    free[0] = False
    flying = free.sum(axis=0)
    rows = float(flying[flying > 0].mean()) if flying.any() else 0.0
    return _floor(length(flown - measured.position), angle(turned, measured.orientation), free, rows)


def _turned(orientation: Floats, rate: Floats, time: Floats) -> Floats:
    """Orientations [time, env, 4] of bodies that turn at a constant rate [rad/s] in the world's frame."""
    speed = length(rate)
    axis = rate / np.maximum(speed, 1e-12)[:, np.newaxis]
    half = speed * time / 2.0
    w, v = np.cos(half), np.sin(half)[..., np.newaxis] * axis
    w0, v0 = orientation[:, 0], orientation[:, 1:]
    scalar = w * w0 - (v * v0).sum(axis=-1)
    vector = w[..., np.newaxis] * v0 + w0[:, np.newaxis] * v + np.cross(v, np.broadcast_to(v0, v.shape))
    return np.concatenate([scalar[..., np.newaxis], vector], axis=-1)


def _mean(values: Floats, chosen: NDArray[np.bool_]) -> Floats:
    """Mean over time of what is chosen, shape [env]."""
    return np.asarray(np.where(chosen, values, 0.0).sum(axis=0) / np.maximum(chosen.sum(axis=0), 1))
