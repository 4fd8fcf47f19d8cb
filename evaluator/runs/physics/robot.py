"""What a recording says of a robot's joints."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.facts import Check, Facts, measured
from gpusimbench.evaluator.runs.physics.states import drawn_envs
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording

Array = npt.NDArray[np.float64]

GROUP = "robot"

_CHUNK_NUMBERS = 1 << 19
_LARGE = 1e9  # of an angle [rad]: the simulation blew up


def robot_facts(recording: Recording) -> Facts:
    """Whether angles are finite, and how far the farthest is beyond its limits."""
    array = recording.state(GROUP, "qpos")
    limits = limits_of(recording, array.field.items)
    if isinstance(limits, Missing):
        return {Check.JOINT_LIMIT: limits}
    lower, upper, fastest = limits
    beyond, blown = [], []
    for first, last in drawn_envs(recording.configuration.n_env):
        rows = max(1, _CHUNK_NUMBERS // ((last - first + 1) * array.shape[2]))
        deepest = np.full(last - first + 1, -np.inf)
        bad = np.zeros(last - first + 1, dtype=bool)
        for begin in range(0, len(array), rows):
            angle = array.read(slice(begin, begin + rows), slice(first, last + 1))[..., 0].astype(np.float64)
            bad |= ~(np.abs(angle) <= _LARGE).all(axis=(0, 2))
            angle = np.where(np.abs(angle) <= _LARGE, angle, 0.0)
            deepest = np.maximum(deepest, np.maximum(angle - upper, lower - angle).max(axis=(0, 2)))
        beyond += deepest.tolist()
        blown += bad.astype(np.float64).tolist()
    dt = recording.configuration.dt
    finite = measured(blown, low=0.0, high=0.0, tolerance=0.0, of="none")
    if any(blown):
        return {Check.FINITE: finite, Check.JOINT_LIMIT: Missing("angles are not finite")}
    return {
        Check.FINITE: finite,
        Check.JOINT_LIMIT: measured(
            beyond, low=None, high=0.0, tolerance=fastest * dt,
            of="largest published joint speed, times dt",
        ),
    }  # fmt: skip


def limits_of(recording: Recording, items: tuple[str, ...]) -> tuple[Array, Array, float] | Missing:
    """Lower and upper limit [rad] of each joint and the largest speed [rad/s], or why the scene does not tell them.

    DamagedRecording where the scene is unreadable.
    """
    try:
        links = checks.objects(checks.mapping(recording.scene, "robot"), "links")
        joints = [checks.mapping(link, "joint") for link in links if link.get("joint") is not None]
        named = {checks.text(joint, "name"): joint for joint in joints}
        if any(item not in named for item in items):
            return Missing("the scene does not describe every joint")
        found = [
            [checks.number(named[item], key, -_LARGE, _LARGE) for key in ("lower", "upper", "max_velocity")]
            for item in items
        ]
    except DamagedRecording as error:
        raise DamagedRecording(f"{recording.path}: {error}") from None
    lower, upper, speed = np.array(found).T
    return lower, upper, float(speed.max())
