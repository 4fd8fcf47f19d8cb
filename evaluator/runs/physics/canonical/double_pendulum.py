"""The laws of the scene double-pendulum: the energy of both, and the periods of the small one's normal modes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.double_pendulum import DoublePendulum
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import cycles, joints_of, unevenness
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Array = npt.NDArray[np.float64]

_LARGE = 1e6
_SMALL = 1e-9
_PAIRS = {"large": slice(0, 2), "small": slice(2, 4)}
"""Joints of each pendulum, the upper before the lower."""


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
        fewest = max(1, min((count for _, count in found if count), default=1))
        made.append(
            LawValues(
                f"{name}_period", f"period of the {name} normal mode", "s",
                tuple(one for one, _ in found), (period,) * len(found),
                dt / fewest + period * largest**2, "dt over the periods measured + T a^2",
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
