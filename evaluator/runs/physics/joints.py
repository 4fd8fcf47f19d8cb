"""What a recording with joints says of mechanics: whether states are finite, and whether joints keep to their limits.

Energy and contacts are not looked at: neither the masses of links nor what hangs on a free body follow from states.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.runs.outcome import joint_fields, positional
from gpusimbench.evaluator.runs.physics.facts import Check, Fact, Facts, measured
from gpusimbench.evaluator.runs.physics.states import drawn_envs
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import damage_in
from gpusimbench.schemas.fields import StateField

Array = npt.NDArray[np.float64]
Envs = tuple[int, int]
Limits = tuple[StateField, Array, Array, float]
"""Of a field of hinges: lower and upper limit of each [rad], and the largest speed of any [rad/s]."""

_CHUNK_NUMBERS = 1 << 19
_LARGE = 1e9  # in any SI unit: the simulation blew up


def joint_facts(recording: Recording) -> Facts:
    """Whether joints and bodies are finite, and how far the farthest hinge is beyond its limits."""
    fields = (*joint_fields(recording.fields), *positional(recording.fields))
    blown = np.concatenate([
        np.any([_blown_up(recording.state(field.group, field.field), envs) for field in fields], axis=0)
        for envs in drawn_envs(recording.configuration.n_env)
    ])  # fmt: skip
    finite = measured(blown.astype(np.float64), low=0.0, high=0.0, tolerance=0.0, of="none")
    limits = limits_of(recording)
    if blown.any() and not isinstance(limits, Missing):
        return {Check.FINITE: finite, Check.JOINT_LIMIT: Missing("states are not finite")}
    return {Check.FINITE: finite, Check.JOINT_LIMIT: _beyond(recording, limits)}


def _blown_up(array: StateArray, envs: Envs) -> npt.NDArray[np.bool_]:
    bad = np.zeros(envs[1] - envs[0] + 1, dtype=np.bool_)
    for rows in _rows(array, envs):
        bad |= ~(np.abs(rows) <= _LARGE).all(axis=(0, 2, 3))
    return bad


def _beyond(recording: Recording, limits: tuple[Limits, ...] | Missing) -> Fact:
    if isinstance(limits, Missing):
        return limits
    beyond: list[float] = []
    for envs in drawn_envs(recording.configuration.n_env):
        deepest = np.full(envs[1] - envs[0] + 1, -np.inf)
        for field, lower, upper, _ in limits:
            for rows in _rows(recording.state(field.group, field.field), envs):
                angle = rows[..., 0]
                deepest = np.maximum(deepest, np.maximum(angle - upper, lower - angle).max(axis=(0, 2)))
        beyond += deepest.tolist()
    fastest = max(speed for _, _, _, speed in limits)
    return measured(
        beyond, tolerance=fastest * recording.configuration.dt, of="largest published joint speed, times dt"
    )


def _rows(array: StateArray, envs: Envs) -> Iterator[Array]:
    count = max(1, _CHUNK_NUMBERS // ((envs[1] - envs[0] + 1) * array.shape[2] * array.shape[3]))
    for begin in range(0, len(array), count):
        yield array.read(slice(begin, begin + count), slice(envs[0], envs[1] + 1)).astype(np.float64)


def limits_of(recording: Recording) -> tuple[Limits, ...] | Missing:
    """The limits of the hinges of each field, or why the scene does not tell them.

    DamagedRecording where the scene is unreadable.
    """
    fields = [field for field in joint_fields(recording.fields) if field.field == "qpos"]
    with damage_in(recording.path):
        links = checks.objects(checks.mapping(recording.scene, "robot"), "links")
        joints = [checks.mapping(link, "joint") for link in links if link.get("joint") is not None]
        named = {checks.text(joint, "name"): joint for joint in joints}
        if {unit for field in fields for unit in field.units} != {"rad"}:
            return Missing("only limits of hinges are looked at")
        if any(item not in named for field in fields for item in field.items):
            return Missing("scene.json does not describe every joint with its limits")
        return tuple((field, *_limits([named[item] for item in field.items])) for field in fields)


def _limits(joints: Sequence[dict[str, Any]]) -> tuple[Array, Array, float]:
    keys = ("lower", "upper", "max_velocity")
    lower, upper, speed = np.array([[checks.number(joint, key, -_LARGE, _LARGE) for key in keys] for joint in joints]).T
    return lower, upper, float(speed.max())
