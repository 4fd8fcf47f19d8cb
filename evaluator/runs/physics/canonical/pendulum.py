"""The laws of the scenes pendulum and double-pendulum: periods at finite amplitude or of normal modes, and energy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.closed_form import DoublePendulum, pendulum_period
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import cycles, fewest_periods, joints_of, unevenness
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Array = npt.NDArray[np.float64]

_LARGE = 1e6
_NO_PERIOD = "no whole period was recorded"

_SMALL = 1e-9
_PAIRS = {"large": slice(0, 2), "small": slice(2, 4)}
"""Joints of each pendulum, the upper before the lower."""


def pendulum_laws(recording: Recording) -> tuple[LawValues, ...] | Missing:
    """The laws, or why none can be measured; DamagedRecording where the scene does not describe a pendulum."""
    read = joints_of(recording)
    if isinstance(read, Missing):
        return read
    time, angle, speed = read[0], read[1][..., 0], read[2][..., 0]
    if not np.abs(angle[0]).max() < math.pi:
        return Missing("a pendulum starts at or above its highest position")
    weight, inertia = _rod(recording)
    small = 2.0 * math.pi * math.sqrt(inertia / weight)
    found, energies, works = [], [], []
    for env in range(angle.shape[1]):
        found.append(cycles(time, angle[:, env]))
        energy = weight * (1.0 - np.cos(angle[:, env])) + 0.5 * inertia * speed[:, env] ** 2
        changed, work = _change(time, energy, speed[:, env], found[-1][0])
        energies.append(changed)
        works.append(work)
    taken = np.array([work for work in works if math.isfinite(work)])
    predicted = pendulum_period(angle[0], small)
    dt = recording.configuration.dt
    return (
        LawValues(
            "period", "period of the pendulum", "s", tuple(period for period, _ in found), tuple(map(float, predicted)),
            dt / fewest_periods(found), "dt over the periods measured",
            (("mass", 0.0), ("damping", 0.0)), _NO_PERIOD,
        ),
        LawValues(
            "energy_change", "energy of the last period above that of the first, over it", "",
            tuple(energies), (0.0,) * len(energies), (2.0 * math.pi * dt / small) ** 2, "(omega dt)^2",
            (("mass", 0.0), ("damping", -float(taken.mean()) if len(taken) else 0.0)), _NO_PERIOD,
            (("damping", unevenness(taken)),),
        ),
    )  # fmt: skip


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


def double_pendulum_laws(recording: Recording) -> tuple[LawValues, ...] | Missing:
    """The laws, or why none can be measured; DamagedRecording where the scene does not describe two such pendulums."""
    found = joints_of(recording)
    if isinstance(found, Missing):
        return found
    time, angle, speed = found
    links = _links(recording)
    if angle.shape[2] != len(links):
        raise DamagedRecording(f"{angle.shape[2]} joints were recorded, and the scene has {len(links)}")
    dt = recording.configuration.dt
    laws: list[LawValues] = []
    for name, joints in _PAIRS.items():
        pendulum = _described(recording, links[joints])
        # angles of lower rods are relative to the upper ones
        upright, turning = np.cumsum(angle[..., joints], axis=-1), np.cumsum(speed[..., joints], axis=-1)
        laws.append(_energy(name, pendulum, time, upright, turning, speed[..., joints], dt))
        if name == "small":
            laws += _modes(pendulum, time, upright, dt)
    return tuple(laws)


def _energy(
    name: str, pendulum: DoublePendulum, time: Array, angle: Array, turning: Array, joint: Array, dt: float
) -> LawValues:
    slow, fast = pendulum.modes()[0]
    window = 2.0 * math.pi / slow
    first, last = time <= window, time >= time[-1] - window
    energy = pendulum.energy(angle, turning)
    before = energy[first].mean(axis=0)
    short = time[-1] < 2.0 * window or not (before > 0.0).all()
    none = np.full(angle.shape[1], math.nan)
    changed = none if short else energy[last].mean(axis=0) / before - 1.0
    lost = none if short else (joint**2).sum(axis=-1).mean(axis=0) * (time[-1] - window) / before
    return LawValues(
        f"{name}_energy", f"energy of the {name} swing, last above first {window:.3g} s, over it", "",
        tuple(map(float, changed)), (0.0,) * len(changed), dt / window + float(fast * dt) ** 2,
        "dt / T + (omega dt)^2", (("mass", 0.0), ("damping", 0.0 if short else -float(lost.mean()))),
        f"less than {2.0 * window:.3g} s were recorded, or a pendulum starts at rest",
        () if short else (("damping", unevenness(lost)),),
    )  # fmt: skip


def _modes(pendulum: DoublePendulum, time: Array, angle: Array, dt: float) -> list[LawValues]:
    frequencies, to_modes = pendulum.modes()
    largest = float(np.abs(angle).max())
    made = []
    for name, frequency, row in zip(("slow", "fast"), frequencies, to_modes, strict=True):
        period = 2.0 * math.pi / float(frequency)
        found = [cycles(time, angle[:, env] @ row) for env in range(angle.shape[1])]
        made.append(
            LawValues(
                f"{name}_period", f"period of the {name} normal mode", "s",
                tuple(one for one, _ in found), (period,) * len(found),
                dt / fewest_periods(found) + period * largest**2, "dt over the periods measured + T a^2",
                (("mass", 0.0), ("gravity", -period / 2.0)), "no whole period was recorded",
            )
        )  # fmt: skip
    return made


def _links(recording: Recording) -> list[dict[str, Any]]:
    """The links that turn, in the order of the joints."""
    links = checks.objects(checks.mapping(recording.scene, "robot"), "links")
    moving = [link for link in links if link.get("joint") is not None]
    if len(moving) != sum(joints.stop - joints.start for joints in _PAIRS.values()):
        raise DamagedRecording("two double pendulums have four joints")
    return moving


def _described(recording: Recording, links: list[dict[str, Any]]) -> DoublePendulum:
    _, _, down = checks.vector(recording.scene.get("gravity"), 3, "gravity")
    if not -_LARGE < down < 0.0:
        raise DamagedRecording("a pendulum needs gravity along -z")
    masses, inertias, centres = [], [], []
    for link in links:
        inertial = checks.mapping(link, "inertial")
        mass = checks.number(inertial, "mass", _SMALL, _LARGE)
        x, y, _ = checks.vector(inertial.get("centre"), 3, "a centre of mass")
        about = checks.vector(inertial.get("inertia"), 6, "moments of inertia")[2]
        if x or not -_LARGE < y < 0.0 or not 0.0 < about < _LARGE:
            raise DamagedRecording("a pendulum's centre of mass is below its joint, and its moment of inertia positive")
        masses.append(mass)
        inertias.append(about + mass * y**2)
        centres.append(-y)
    x, y, z = checks.vector(links[1].get("position"), 3, "a link's position")
    if x or z or not -_LARGE < y < 0.0:
        raise DamagedRecording("the lower rod hangs below the upper one")
    return DoublePendulum((masses[0], masses[1]), (inertias[0], inertias[1]), (centres[0], centres[1]), -y, -down)
