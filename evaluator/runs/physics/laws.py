"""Motions that are known in closed form, environment by environment: what a run did, and what mechanics predicts."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.closed_form import (  # fmt: skip
    pendulum_period,
    sliding_acceleration,
    stopping_distance,
)
from gpusimbench.evaluator.metrics.physics.solids import rotations
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.evaluator.runs.physics.states import MOST_ENVS, Walk, drawn_envs
from gpusimbench.evaluator.runs.physics.world import Moving, world_of
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Array = npt.NDArray[np.float64]

_SETTLED = 0.1  # until when soft contacts come to bear [s]
_SLOW = 0.1  # share of a block's speed at which it is no longer looked at, lest it stop within a step
_STILL = 0.01  # share of it at which it has stopped
_FEWEST = 5  # rows of a fit
_MOST_NUMBERS = 4_000_000  # rows times environments times bodies: of more, nothing is looked at
_BLOWN = 1e9  # in any SI unit
_LARGE = 1e6


def laws_of(recording: Recording) -> tuple[LawValues, ...]:
    """The laws of a canonical scene; empty for other scenes, and for runs that were changed on the way.

    Raises DamagedRecording where the file does not hold what it should.
    """
    c = recording.configuration
    varied = {part.partition(":")[0] for part in c.vary.split(",")} if c.vary else set()
    if c.intervention or varied - {"mass", "shift", "but"} or c.model:
        return ()
    try:
        if c.scene == "pendulum":
            return _pendulum(recording)
        return _blocks(recording) if c.scene == "sliding-block" else ()
    except DamagedRecording as error:
        raise DamagedRecording(f"{recording.path}: {error}") from None


def _pendulum(recording: Recording) -> tuple[LawValues, ...]:
    kinds = {field.field for field in recording.fields if field.group == "robot"}
    if not {"qpos", "qvel"} <= kinds:
        return ()
    angles = recording.state("robot", "qpos")
    if not 2 <= len(angles) <= _MOST_NUMBERS // MOST_ENVS or len(recording.state("robot", "qvel")) != len(angles):
        return ()
    angle, speed = (_joint(recording, field) for field in ("qpos", "qvel"))
    if not (_finite(angle, speed) and np.abs(angle[0]).max() < math.pi):
        return ()
    time = angles.steps[:].astype(np.float64) * recording.configuration.dt
    weight, inertia = _rod(recording)
    small = 2.0 * math.pi * math.sqrt(inertia / weight)
    amplitude = np.abs(angle[0])
    periods, energies, works = [], [], []
    for env in range(angle.shape[1]):
        start, stop, count = _swings(time, angle[:, env])
        periods.append((stop - start) / count if count else math.nan)
        energy = weight * (1.0 - np.cos(angle[:, env])) + 0.5 * inertia * speed[:, env] ** 2
        changed, work = _change(time, energy, speed[:, env], periods[-1])
        energies.append(changed)
        works.append(work)
    predicted = pendulum_period(amplitude, small)
    dt = recording.configuration.dt
    fewest = max(1.0, float(np.floor(time[-1] / predicted.max())) - 1.0)
    return (
        LawValues(
            "period", "period of the pendulum", "s", tuple(periods), tuple(map(float, predicted)),
            dt / fewest, "dt over the periods measured",
            (("mass", 0.0), ("damping", 0.0)),
        ),
        LawValues(
            "energy_change", "energy of the last period above that of the first, over it", "",
            tuple(energies), (0.0,) * len(energies), (2.0 * math.pi * dt / small) ** 2, "(omega dt)^2",
            (("mass", 0.0), ("damping", -_finite_mean(works))),
        ),
    )  # fmt: skip


def _joint(recording: Recording, field: str) -> Array:
    parts = [
        recording.state("robot", field).read(slice(None), slice(first, last + 1))[:, :, 0, 0]
        for first, last in drawn_envs(recording.configuration.n_env)
    ]
    return np.asarray(np.concatenate(parts, axis=1), dtype=np.float64)


def _rod(recording: Recording) -> tuple[float, float]:
    """m g l [N m] and the moment of inertia about the axis [kg m2]."""
    _, _, z = checks.vector(recording.scene.get("gravity"), 3, "gravity")
    links = checks.objects(checks.mapping(recording.scene, "robot"), "links")
    moving = [link for link in links if link.get("joint") is not None]
    if len(moving) != 1 or not z < 0:
        raise DamagedRecording("a pendulum has one joint, and gravity along -z")
    inertial = checks.mapping(moving[0], "inertial")
    mass = checks.number(inertial, "mass", 1e-9, _LARGE)
    x, y, _ = checks.vector(inertial.get("centre"), 3, "a centre of mass")
    about = checks.vector(inertial.get("inertia"), 6, "moments of inertia")[2]
    length = math.hypot(x, y)
    if not (0 < length < _LARGE and 0 < about + mass * length**2 < _LARGE):
        raise DamagedRecording("the pendulum's centre of mass is on its axis, or its inertia is that of no body")
    return mass * -z * length, about + mass * length**2


def _swings(time: Array, angle: Array) -> tuple[float, float, int]:
    """First and last passage upward through the lowest position, and the periods between them."""
    at = np.nonzero((angle[:-1] < 0.0) & (angle[1:] >= 0.0))[0]
    if len(at) < 2:
        return 0.0, 0.0, 0
    first, last = (float(time[i] - angle[i] * (time[i + 1] - time[i]) / (angle[i + 1] - angle[i])) for i in at[[0, -1]])
    return first, last, len(at) - 1


def _change(time: Array, energy: Array, speed: Array, period: float) -> tuple[float, float]:
    """Change of the energy of a period from the first to the last, over the first, and what a joint's damping of 1 N m
    s/rad takes of it, by the work c w^2 along the recorded motion."""
    if not period > 0.0:
        return math.nan, math.nan
    first, last = time <= period, time >= time[-1] - period
    before = float(energy[first].mean())
    if not before > 0.0:
        return math.nan, math.nan
    lost = float((speed**2).mean()) * (time[-1] - period)
    return float(energy[last].mean()) / before - 1.0, lost / before


def _finite(*arrays: Array) -> bool:
    return all(bool((np.abs(array) <= _BLOWN).all()) for array in arrays)


def _finite_mean(values: list[float]) -> float:
    finite = [value for value in values if math.isfinite(value)]
    return sum(finite) / len(finite) if finite else 0.0


def _blocks(recording: Recording) -> tuple[LawValues, ...]:
    walk = Walk(recording, drawn_envs(recording.configuration.n_env))
    if not walk.groups or not 2 <= len(walk) <= _MOST_NUMBERS // (MOST_ENVS * len(walk.items)):
        return ()
    world = world_of(recording, walk.items)
    states = walk.rows(0, len(walk))
    if isinstance(world, Missing) or states.linear is None or states.orientation is None:
        return ()
    if not _finite(states.position, states.linear, states.orientation):
        return ()
    time = (states.step - states.step[0]) * recording.configuration.dt
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
    if settled + _FEWEST >= len(time):
        return []
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
            (("mass", 0.0), ("friction", -longer * share / predicted)),
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
