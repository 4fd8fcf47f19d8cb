"""The laws of the scene pendulum: its period at finite amplitude, and its energy."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.closed_form import pendulum_period
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import cycles, joints_of, unevenness
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Array = npt.NDArray[np.float64]

_LARGE = 1e6
_NO_PERIOD = "no whole period was recorded"


def pendulum_laws(recording: Recording) -> tuple[LawValues, ...] | Missing:
    """The laws, or why none can be measured; DamagedRecording where the scene does not describe a pendulum."""
    found = joints_of(recording)
    if isinstance(found, Missing):
        return found
    time, angle, speed = found[0], found[1][..., 0], found[2][..., 0]
    if not np.abs(angle[0]).max() < math.pi:
        return Missing("a pendulum starts at or above its highest position")
    weight, inertia = _rod(recording)
    small = 2.0 * math.pi * math.sqrt(inertia / weight)
    amplitude = np.abs(angle[0])
    periods, energies, works = [], [], []
    for env in range(angle.shape[1]):
        periods.append(cycles(time, angle[:, env])[0])
        energy = weight * (1.0 - np.cos(angle[:, env])) + 0.5 * inertia * speed[:, env] ** 2
        changed, work = _change(time, energy, speed[:, env], periods[-1])
        energies.append(changed)
        works.append(work)
    taken = np.array([work for work in works if math.isfinite(work)])
    predicted = pendulum_period(amplitude, small)
    dt = recording.configuration.dt
    fewest = max(1.0, float(np.floor(time[-1] / predicted.max())) - 1.0)
    return (
        LawValues(
            "period", "period of the pendulum", "s", tuple(periods), tuple(map(float, predicted)),
            dt / fewest, "dt over the periods measured",
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
