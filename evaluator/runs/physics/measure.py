"""All that a recording's states say of mechanics, in bounded memory.

Of joints that is whether states are finite, and whether joints keep to their limits. Energy and contacts are not looked
at: neither the masses of links nor what hangs on a free body follow from states.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.runs.physics.balance import Balance
from gpusimbench.evaluator.runs.physics.depth import Depths, Sunk, count_sunk, end_facts
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Check, Fact, Facts, PhysicsFacts, Revision, measured
from gpusimbench.evaluator.runs.physics.gravity import Slides, fall_facts, slope_facts
from gpusimbench.evaluator.runs.physics.laws import laws_of
from gpusimbench.evaluator.runs.physics.states import Setting, States, Walk, drawn_envs
from gpusimbench.evaluator.runs.physics.world import world_of
from gpusimbench.evaluator.runs.positions import joint_fields, no_states, positional
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import damage_in
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.treatment import Intervention

Array = npt.NDArray[np.float64]
Envs = tuple[int, int]
Limits = tuple[StateField, Array, Array, float]
"""Of a field of hinges: lower and upper limit of each [rad], and the largest speed of any [rad/s]."""

_CHUNK_NUMBERS = 1 << 19
_BLOWN = 1e9  # in any SI unit: the simulation blew up
_LONGEST = 1e9  # [s]
_UNIT = 2e-3  # rounding of an engine that computes in half precision makes a quaternion this much longer or shorter
_WITH_JOINTS = Missing("the scene has joints; contacts and energy are looked at in scenes of balls and cubes alone")
_NO_JOINTS = Missing("the scene has no joints")


def joint_facts(recording: Recording) -> Facts:
    """Whether joints and bodies are finite, and how far the farthest hinge is beyond its limits."""
    fields = (*joint_fields(recording.fields), *positional(recording.fields))
    blown = np.concatenate([
        np.any([_joints_blown_up(recording.state(field.group, field.field), envs) for field in fields], axis=0)
        for envs in drawn_envs(recording.configuration.n_env)
    ])  # fmt: skip
    finite = measured(blown.astype(np.float64), low=0.0, high=0.0, tolerance=0.0, of="none")
    limits = limits_of(recording)
    if blown.any() and not isinstance(limits, Missing):
        return {Check.FINITE: finite, Check.JOINT_LIMIT: Missing("states are not finite")}
    return {Check.FINITE: finite, Check.JOINT_LIMIT: _beyond(recording, limits)}


def _joints_blown_up(array: StateArray, envs: Envs) -> npt.NDArray[np.bool_]:
    bad = np.zeros(envs[1] - envs[0] + 1, dtype=np.bool_)
    for rows in _rows(array, envs):
        bad |= ~(np.abs(rows) <= _BLOWN).all(axis=(0, 2, 3))
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
    lower, upper, speed = np.array([[checks.number(joint, key, -_BLOWN, _BLOWN) for key in keys] for joint in joints]).T
    return lower, upper, float(speed.max())


def physics_of(recording: Recording, sank: Sunk | Missing | None = None, revision: Revision = NEWEST) -> PhysicsFacts:
    """What can be measured of a usable recording.

    sank      what evaluator.runs.physics.depth.count_sunk found, where it is known already
    revision  of the tolerances

    Raises DamagedRecording where the file does not hold what it should.
    """
    n_env = recording.configuration.n_env
    envs = drawn_envs(n_env)

    facts = _facts(recording, envs, sank, revision)
    if not isinstance(facts, Missing):
        facts = {check: facts.get(check, _NO_JOINTS) for check in Check}
    return PhysicsFacts(recording.configuration.scene, n_env, envs, facts, revision, laws_of(recording))


def _facts(
    recording: Recording, envs: tuple[tuple[int, int], ...], sank: Sunk | Missing | None, revision: Revision
) -> Facts | Missing:
    if recording.configuration.simulator == REAL:
        return Missing("these are measured trials, with one row each")
    if joint_fields(recording.fields):
        if not len(recording.state(*_first(recording))):
            return no_states(recording)
        bodies = {Check.SANK: _sank(count_sunk(recording) if sank is None else sank)}
        return {
            **dict.fromkeys(Check, _WITH_JOINTS),
            **joint_facts(recording),
            **(bodies if positional(recording.fields) else {}),
        }
    done = Intervention.of(recording.configuration.intervention)
    if done and done.kind.changes:
        return Missing("environments were changed on the way")
    walk = Walk(recording, envs)
    if not walk.groups:
        return Missing("no positions in three dimensions were recorded")
    if len(walk) < 2:
        return no_states(recording)
    world = world_of(recording, walk.items)
    if isinstance(world, Missing):
        return world
    c = recording.configuration
    setting = Setting(walk, world, c.dt, c.stride, _sample_time(recording), c.initial, revision)
    found = _of_states(setting)
    if c.vary:
        why = Missing(f"environments have other parameters than the scene, by which it is checked (--vary {c.vary})")
        found = {check: fact if check is Check.FINITE else why for check, fact in found.items()}
    return {**found, Check.SANK: _sank(count_sunk(recording) if sank is None else sank)}


def _first(recording: Recording) -> tuple[str, str]:
    field = joint_fields(recording.fields)[0]
    return field.group, field.field


def check_described(recording: Recording) -> None:
    """Read what mechanics needs of the scene; DamagedRecording where a part of it is unreadable."""
    if recording.configuration.simulator == REAL:
        return
    if joint_fields(recording.fields):
        limits_of(recording)
        return
    walk = Walk(recording, drawn_envs(recording.configuration.n_env))
    if walk.groups and not isinstance(world_of(recording, walk.items), Missing):
        _sample_time(recording)


def _of_states(setting: Setting) -> Facts:
    depths, balance, slides = Depths(setting), Balance(setting), Slides(setting)
    lengths = _Lengths(setting.walk)
    blown: npt.NDArray[np.bool_] | None = None
    last: States | None = None
    for states in setting.walk.chunks():
        bad = _blown_up(states)
        blown = bad if blown is None else blown | bad
        if blown.any():
            break
        depths.feed(states)
        balance.feed(states)
        slides.feed(states)
        lengths.feed(states)
        last = states
    assert blown is not None
    finite = measured(blown.astype(np.float64), low=0.0, high=0.0, tolerance=0.0, of="none", note=lengths.said)
    if blown.any() or last is None:
        others = [check for check in Check if check not in (Check.FINITE, Check.SANK, Check.JOINT_LIMIT)]
        return {Check.FINITE: finite, **dict.fromkeys(others, Missing("states are not finite"))}
    return {
        Check.FINITE: finite,
        **slope_facts(setting),
        **fall_facts(setting),
        **balance.facts(),
        Check.SLIDING: slides.fact(),
        **depths.facts(),
        **end_facts(setting, last),
    }


def _blown_up(states: States) -> npt.NDArray[np.bool_]:
    arrays = (states.position, states.orientation, states.linear, states.angular)
    good = [(np.abs(array) <= _BLOWN).all(axis=(0, 2, 3)) for array in arrays if array is not None]
    return np.asarray(~np.logical_and.reduce(good))


class _Lengths:
    """Looks for orientations that are not unit quaternions, which no check of mechanics notices.

    said  the first of them; empty where there is none
    """

    def __init__(self, walk: Walk) -> None:
        self._walk = walk
        self.said = ""

    def feed(self, states: States) -> None:
        """Take the next rows."""
        if self.said or states.orientation is None:
            return
        length = np.linalg.norm(states.orientation[:, states.distinct], axis=3)
        wrong = np.argwhere(np.abs(length - 1.0) > _UNIT)
        if len(wrong):
            row, env, body = wrong[0]
            (_, name), number = self._walk.items[body], self._walk.env_numbers[states.distinct[env]]
            self.said = (
                f"orientations are not unit quaternions: the first has length {length[row, env, body]:.4g} "
                f"({name} at step {states.step[row]:.0f}, environment {number})"
            )


def _sank(found: Sunk | Missing) -> Fact:
    if isinstance(found, Missing):
        return found
    return measured(found.per_env, low=0.0, high=0.0, tolerance=0.0, of="none")


def _sample_time(recording: Recording) -> float:
    with damage_in(recording.path):
        return checks.number(recording.scene, "sample_time", 0.0, _LONGEST)
