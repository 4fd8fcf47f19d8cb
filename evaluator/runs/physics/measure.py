"""All that a recording's states say of mechanics, in bounded memory."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.outcome import joint_fields, no_states, positional
from gpusimbench.evaluator.runs.physics.balance import Balance
from gpusimbench.evaluator.runs.physics.depth import Depths, Sunk, count_sunk, end_facts
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Check, Fact, Facts, PhysicsFacts, Revision, measured
from gpusimbench.evaluator.runs.physics.gravity import Slides, fall_facts, slope_facts
from gpusimbench.evaluator.runs.physics.joints import joint_facts, limits_of
from gpusimbench.evaluator.runs.physics.laws import laws_of
from gpusimbench.evaluator.runs.physics.states import Setting, States, Walk, drawn_envs
from gpusimbench.evaluator.runs.physics.world import world_of
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import damage_in
from gpusimbench.schemas.provenance import REAL
from gpusimbench.schemas.treatment import Intervention

_BLOWN = 1e9  # in any SI unit: the simulation blew up
_LONGEST = 1e9  # [s]
_UNIT = 2e-3  # rounding of an engine that computes in half precision makes a quaternion this much longer or shorter
_WITH_JOINTS = Missing("the scene has joints; contacts and energy are looked at in scenes of balls and cubes alone")
_NO_JOINTS = Missing("the scene has no joints")


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
