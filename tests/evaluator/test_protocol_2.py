"""protocol-2: a throughput is that of the scene's own window, of steps that did work, on hardware that could run."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.rules.facts import applies, fact_of
from gpusimbench.evaluator.check.rules.findings import _shell, check
from gpusimbench.evaluator.check.rules.rule import PROTOCOL, Rule, RuleSet, Scope, Severity, load_rules, parse_rules
from gpusimbench.evaluator.inputs.reader import read_run
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PROVENANCE, SIMULATION
from tests.conftest import call, distribution, recorded
from tests.evaluator.damaged import whole
from tests.synthetic import Shown, cubes_field

ROOT = Path(__file__).parents[2]
RULES = load_rules(PROTOCOL)
OLDER = load_rules("protocol-1")
NEW = {rule.id for rule in RULES.rules} - {rule.id for rule in OLDER.rules}
MACHINE = {"runs", "timed-seconds", "recorder-known", "recorder-unmodified"}
"""Rules that the runs of this file break because they are few, or because of the machine and the checkout."""


def broken(*paths: Path) -> set[str]:
    """Rules of protocol-2 that files break."""
    report = check([examine(path) for path in paths], [RULES])
    assert not report.unchecked, report.unchecked
    return {finding.rule.id for finding in report.findings}


def _hardware(times_s: Iterable[float], source: str, **values: Any) -> tuple[tuple[str, str, Any], ...]:
    sample = message_class("gsb.v1.HardwareSample")
    return tuple(
        (f"/hardware/{source}", "gsb.v1.HardwareSample", sample(monotonic_ns=round(t * 1e9), phase="timed", **values))
        for t in times_s
    )


def _hashes(begin: list[int], end: list[int]) -> tuple[tuple[str, str, Any], ...]:
    block = message_class("gsb.v1.FingerprintBlock")(
        first_step=100, steps=2, stride=1000, env_start=0, envs=2, hashes=[*begin, *end]
    )
    return (("/fingerprint/timed", "gsb.v1.FingerprintBlock", block),)


def _actions(first: str, last: str, *, verified: bool = True) -> dict[str, Any]:
    stream = message_class("gsb.v1.ActionStream")(
        envs=2, steps=1000, first_sha256=first * 64, last_sha256=last * 64, verified=verified
    )
    return {"timed": stream}


_ENDS = {"contacts": np.full((2, 2), 27)}
_HASHED = _hashes([1, 2], [3, 4])
_SAMPLED = _hardware((0.0, 0.9, 1.8), "host", other_cpus=0.0)


def run(
    folder: Path,
    *,
    counts: dict[str, Any] = _ENDS,
    hashes: tuple[Any, ...] = _HASHED,
    hardware: tuple[Any, ...] = _SAMPLED,
    streams: dict[str, Any] | None = None,
    asked: dict[str, Any] | None = None,
    declared: tuple[str, ...] = (),
    deviations: tuple[dict[str, str], ...] = (),
    **keywords: Any,
) -> Path:
    """A run of two environments, timed for 2 s over steps 100 to 1,100, that meets the new rules but where told."""

    def change(name: str, record: dict[str, Any]) -> None:
        if name == PROVENANCE:
            record["configuration"] |= asked or {}
        if name == SIMULATION:
            record["counters"] += [{"name": counter, "meaning": "x"} for counter in declared]
            record["deviations"] += deviations

    shown = Shown(counts={"timed": counts}, streams=streams or {}, raw=(*hashes, *hardware))
    said = {"scene": "free-fall", "dt": 0.01, "warmup": 100, "timed_steps": 1000, "elapsed_s": 2.0}
    scene = make_scene({**said, **keywords}["scene"])
    field = cubes_field("float64") if scene.moving() else None
    return whole(folder, final=None, n_env=2, shown=shown, change=change, field=field, **{**said, **keywords})


_TOSS = {
    "scene": "cube-toss",
    "dt": 1 / 148,
    "warmup": 10,
    "timed_steps": 100,
    "asked": {"phases": ["timed", "capture"]},
}
_FRICTION = {"parameter": "cube.static_friction", "wanted": "0.18", "used": "0.2", "reason": "x"}
_BROKEN: dict[str, dict[str, Any]] = {
    "own-start": {"asked": {"initial": "states:" + "0" * 64}},
    "outcome-of-tosses": {**_TOSS, "asked": {"phases": ["timed"]}},
    "window-begin": {"warmup": 1000},
    "window-begin-of-a-toss": {**_TOSS, "warmup": 100},
    "timed-steps": {"timed_steps": 99},
    "window-end": {"timed_steps": 1001},
    "window-end-of-a-toss": {**_TOSS, "timed_steps": 101},
    "timed-seconds": {"elapsed_s": 0.99},
    "work-evidence": {"counts": {}},
    "declared-evidence": {"declared": ("solver_iterations",)},
    "contacts-at-the-end": {"counts": {"contacts": np.array([[27, 27], [1, 0]])}},
    "not-frozen": {"hashes": _hashes([1, 2], [1, 4])},
    "actions-go-on": {"scene": "franka", "streams": _actions("a", "a")},
    "actions-held": {"scene": "franka", "streams": _actions("a", "b", verified=False)},
    "robot-moves": {"scene": "franka", "counts": {**_ENDS, "moving": np.array([[7, 7], [6, 0]])}},
    "clocks-sampled": {"hardware": _hardware((0.2, 0.9, 1.95), "host", other_cpus=0.0)},
    "no-throttling": {
        "gpu_bytes": (1, 2),
        "hardware": (
            *_hardware((0.0, 0.5), "gpu0", throttle_reasons=0x1),
            *_hardware((1.0, 1.5), "gpu0", throttle_reasons=0x5),
        ),
    },
    "closed-division": {**_TOSS, "asked": {"fitted": {"solref": "even tosses"}}},
    "held-out": {**_TOSS, "asked": {"fitted": {"solref": "even tosses", "friction": "all tosses"}}},
    "given-facts": {**_TOSS, "deviations": (_FRICTION,)},
}
_HELD: dict[str, dict[str, Any]] = {
    "outcome-of-tosses": _TOSS,
    "window-begin-of-a-toss": _TOSS,
    "window-end-of-a-toss": _TOSS,
    "closed-division": _TOSS,
    "held-out": {**_TOSS, "asked": {"fitted": {"solref": "even tosses"}}},
    "given-facts": {**_TOSS, "deviations": ({**_FRICTION, "used": "0.180"},)},
    "declared-evidence": {"counts": {**_ENDS, "solver_iterations": np.full((2, 2), 3)}},
    "actions-go-on": {"scene": "franka", "streams": _actions("a", "b")},
    "actions-held": {"scene": "franka", "streams": _actions("a", "b")},
    "robot-moves": {"scene": "franka", "counts": {**_ENDS, "moving": np.array([[7, 7], [3, 4]])}},
    "clocks-sampled": {"hardware": _hardware((0.9, 1.8), "host", other_cpus=0.0)},
    "no-throttling": {
        "gpu_bytes": (1, 2),
        "hardware": _hardware((0.0, 0.5, 1.0, 1.5), "gpu0", throttle_reasons=0x1),
    },
}
_OTHERWISE = {
    "not-frozen": {"hashes": ()},
    "actions-go-on": {"scene": "franka"},
    "actions-held": {"scene": "franka"},
    "robot-moves": {"scene": "franka", "counts": {**_ENDS, "moving": np.array([[0, 0], [7, 7]])}},
    "clocks-sampled": {"hardware": ()},
    "work-evidence": {"counts": {"contacts": np.full((1, 2), 27)}},
}
"""Other ways to break a rule: what should show the work is not in the file."""


@pytest.mark.parametrize("rule", _BROKEN)
def test_each_new_rule(rule: str, tmp_path: Path) -> None:
    """Break each rule alone, and hold it where nothing but that is otherwise."""
    assert rule in broken(run(tmp_path, **_BROKEN[rule]))
    assert rule not in broken(run(tmp_path, **_HELD.get(rule, {})))
    if rule in _OTHERWISE:
        assert rule in broken(run(tmp_path, **_OTHERWISE[rule]))


def test_every_new_rule_is_tested_and_says_what_is_wrong() -> None:
    """Have a case for every rule that protocol-1 does not have, and of every rule say what is wrong and what to do."""
    assert set(_BROKEN) - {"timed-steps"} | {"same-window"} == NEW
    assert all(rule.broken and rule.broken != rule.requires and rule.do.endswith(".") for rule in RULES.rules)
    for rule in RULES.rules:
        if rule.id == "scene-unchanged":
            assert {make_scene(name).sha256() for name in rule.scenes} == set(rule.argument)


_WARNINGS = {"complete", "recorder-known", "recorder-unmodified", "distinct-numbers", "outcome-of-tosses"}


@pytest.mark.parametrize("rules", [OLDER, RULES], ids=lambda rules: rules.name)
def test_a_broken_rule_fails_a_set(rules: RuleSet) -> None:
    """Warn of runs that are not complete, of the recorder's code, of run numbers and of tosses without an outcome;
    every other broken rule fails, and none of them is damage."""
    named = {rule.id for rule in rules.rules}
    assert {rule.id for rule in rules.rules if rule.level is Severity.warning} == _WARNINGS & named
    assert not any(rule.damage for rule in rules.rules)


@pytest.mark.parametrize("scene", ["inclined-collision", "free-fall", "franka"])
def test_every_scene_but_the_toss_is_timed_over_one_window(scene: str, tmp_path: Path) -> None:
    """Ask each of the scenes for its first state, its own time step, and steps 100 to 1,100 at most."""
    same: dict[str, Any] = {"scene": scene, "streams": _actions("a", "b")} if scene == "franka" else {"scene": scene}
    rules = {"window-begin", "window-end", "timed-steps", "own-start", "dt", "dt-of-scene"}
    for warmup, timed_steps, expected in (
        (99, 1000, {"window-begin"}),
        (101, 1000, {"window-begin"}),
        (100, 1001, {"window-end"}),
        (100, 99, {"timed-steps"}),
        (100, 100, set()),
        (100, 1000, set()),
    ):
        assert broken(run(tmp_path, **same, warmup=warmup, timed_steps=timed_steps)) & rules == expected
    assert broken(run(tmp_path, **same, dt=0.005)) & rules == {"dt", "dt-of-scene"}
    assert broken(run(tmp_path, **same, asked={"initial": "states:" + "0" * 64})) & rules == {"own-start"}


@pytest.mark.parametrize("scene", ["inclined-collision", "free-fall", "cube-toss"])
def test_every_scene_but_the_robot_touches_at_the_end(scene: str, tmp_path: Path) -> None:
    """Ask each of the scenes for a contact of an environment at the last timed step."""
    same = _TOSS if scene == "cube-toss" else {"scene": scene}
    for last, rule in (([1, 0], {"contacts-at-the-end"}), ([1, 1], set())):
        counts = {"contacts": np.array([[27, 27], last])}
        assert broken(run(tmp_path, **same, counts=counts)) & {"contacts-at-the-end"} == rule


def test_a_reading_of_another_gpu_is_none(tmp_path: Path) -> None:
    """Ask for readings of what the simulator steps on: of a run on a GPU, those of the host are not enough."""
    assert "clocks-sampled" in broken(run(tmp_path, gpu_bytes=(1, 2)))
    assert "clocks-sampled" in broken(run(tmp_path, hardware=_hardware((0.0, 0.9, 1.8), "gpu0", sm_clock_mhz=1)))


@pytest.mark.parametrize(("readings", "held"), [(10, True), (9, False)])
def test_a_tenth_of_the_readings_may_be_throttled(readings: int, held: bool, tmp_path: Path) -> None:
    """Take one throttled reading of ten, and not one of nine."""
    reasons = [0x5] + [0x1] * (readings - 1)
    hardware = tuple(
        part
        for number, reason in enumerate(reasons)
        for part in _hardware([number / 5], "gpu0", throttle_reasons=reason)
    )
    assert ("no-throttling" not in broken(run(tmp_path, gpu_bytes=(1, 2), hardware=hardware))) is held


def test_what_never_ended_shows_no_work(tmp_path: Path) -> None:
    """Ask a run that failed for no evidence of work, and a run without a capture for no state at the sample step."""
    whole_window = run(tmp_path)
    nothing: dict[str, Any] = {"hashes": (), "counts": {}, "hardware": (), "elapsed_s": 0.1, "timed_steps": 200}
    failed = run(tmp_path, status="FAILED", reason="gone", **nothing)
    evidence = {"work-evidence", "declared-evidence", "not-frozen", "clocks-sampled", "timed-seconds", "same-window"}
    assert broken(whole_window, failed) & evidence == set()
    assert "sample-step" not in broken(run(tmp_path, scene="inclined-collision"))


def test_one_window_for_all(tmp_path: Path) -> None:
    """Ask all simulators for the same window of a scene, and name the windows; scenes do not mix."""
    same = [run(tmp_path, simulator=name) for name in ("a", "b")]
    arms = run(tmp_path, scene="franka", timed_steps=200, streams=_actions("a", "b"))
    other = run(tmp_path, simulator="c", timed_steps=200)
    assert "same-window" not in broken(*same, arms)
    (found,) = (
        f for f in check([examine(p) for p in (*same, arms, other)], [RULES]).findings if f.rule.id == "same-window"
    )
    assert found.found == "of scene free-fall: steps 100 to 1,100 in 2 files, steps 100 to 300 in 1 file"
    assert found.files == (other,)


# What genesis-world#181 disputes: a throughput that is timed over a world at rest. Recreated with MuJoCo C: the same
# scene, timed over its own window, and once everything has come to rest.
_SCENE = ("--sim", "mujoco", "--scene", "free-fall", "--n-env", 16, "--runs", 1, "--timed-steps", 100)


def _steps_of(name: str) -> Path:
    how: dict[str, tuple[object, ...]] = {
        "honest": ("--phases", "timed"),
        "at rest": ("--phases", "timed", "--warmup", 600),
        "states": ("--phases", "capture", "--steps", 600, "--stride", 600, "--no-view"),
    }
    (path,) = recorded(*_SCENE, *how[name])
    return path


def test_an_honest_run_passes() -> None:
    """Hold every rule of a file for a run of MuJoCo C that is timed over the scene's window."""
    assert broken(_steps_of("honest")) - MACHINE == set()


@pytest.mark.slow
def test_a_world_at_rest_is_rejected(tmp_path: Path) -> None:
    """Reject a run that is timed after everything has come to rest, whichever way it got there."""
    at_rest = _steps_of("at rest")
    assert broken(at_rest) - MACHINE == {"window-begin"}
    assert {"window-begin", "same-window"} <= broken(at_rest, _steps_of("honest"))
    begun = call(
        "gsb-record", *_SCENE, "--phases", "timed", "--initial", f"{_steps_of('states')}@600", "--out", tmp_path, code=0
    )
    path = Path(begun.stdout.strip())
    assert broken(path) - MACHINE == {"own-start"}
    said = call("gsb-check", "--protocol", path, code=ExitCode.GATE_FAILED)
    assert "error own-start: Environments begin in a state that was given or drawn" in " ".join(said.stdout.split())


# The submission of genesis-world#181 itself: the robot gets the action of the first step, and then 999 steps without.
_IDLE = """
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC

class Idle(MujocoC):  # MuJoCo C, which is given the first action alone
    def step(self, n_step):
        actions = None if self._made else self._actions
        if actions is not None:
            self._worlds.write("ctrl", actions[0])
        self._counts = None
        self._made += n_step
        self._worlds.step(n_step)

class Silent(Idle):  # and does not tell which actions it holds
    def applied(self):
        return None

class Liar(Idle):  # and says that it holds those that it was given
    def applied(self):
        return self._actions[-1]
"""


@pytest.mark.slow
def test_one_action_and_999_idle_steps_are_rejected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reject a robot that is given one action, whatever the engine says of it, and hold the same robot that goes on."""
    names = "\n".join(f"{name} = idle_worlds:{name.title()}" for name in ("idle", "silent", "liar"))
    distribution(tmp_path, "idle-worlds", f"[gsb.simulators]\n{names}\n", _IDLE)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(map(str, (tmp_path, ROOT, ROOT / "src"))))
    arguments = ("--scene", "franka", "--n-env", 32, "--runs", 1, "--phases", "timed", "--timed-steps", 999)
    found, status = {}, {}
    for name in ("mujoco", "idle", "silent", "liar"):
        done = call("gsb-record", "--sim", name, *arguments, "--out", tmp_path)
        recording = Recording(Path(done.stdout.strip()))
        found[name], status[name] = broken(recording.path) - MACHINE, recording.status
    assert status == {"mujoco": "complete", "idle": "invalid", "silent": "complete", "liar": "complete"}
    assert found["mujoco"] == set()
    assert found["silent"] == {"actions-held", "robot-moves"}
    assert found["liar"] == {"robot-moves"}


def test_the_newest_protocol_is_the_default(tmp_path: Path) -> None:
    """Ask protocol-2 where no version is named, and protocol-1 where it is."""
    path = run(tmp_path)
    assert "protocol-2" in call("gsb-check", "--protocol", path).stdout.splitlines()[0]
    older = call("gsb-check", "--rules", "integrity-1", "--rules", "protocol-1", path).stdout.splitlines()
    assert "protocol-1" in " ".join(older[:2])


def test_what_was_fitted_is_recorded(tmp_path: Path) -> None:
    """Store which options were fitted to what, and refuse a statement that cannot be meant."""
    toss = ("--sim", "mujoco", "--scene", "cube-toss", "--n-env", 1, "--runs", 1, "--phases", "capture", "--steps", 5)
    solref = ("--option", "solref=0.01 1")
    done = call("gsb-record", *toss, *solref, "--fitted", "solref=even tosses", "--out", tmp_path)
    (finding,) = (f for f in check([examine(done.stdout.strip())], [RULES]).findings if f.rule.id == "closed-division")
    assert finding.found == "solref on even tosses"
    for arguments, message in (
        (("--fitted", "solref=even tosses"), "give its value as well, with --option solref=VALUE"),
        ((*solref, "--fitted", "solref"), "takes an option and what it was fitted to"),
    ):
        refused = call("gsb-record", *toss, *arguments, "--out", tmp_path)
        assert (refused.returncode, message in refused.stderr) == (ExitCode.USAGE, True), refused.stderr


_EXTENDS = """
name = "mine-1"
title = "what our laboratory asks for"
extends = "protocol-1"
without = ["dt", "runs"]

[[rules]]
id = "timed-steps"
level = "warning"
fact = "timed_steps"
must = { at_least = 3 }
requires = "Three steps."
why = "We say so."
do = "Time three."
"""


def test_a_set_that_extends_another() -> None:
    """Take the rules of the extended set in their order, replaced by id, without those that are named."""
    found = parse_rules(_EXTENDS, "mine.toml").rules
    assert [rule.id for rule in found] == [rule.id for rule in OLDER.rules if rule.id not in ("dt", "runs")]
    assert next(rule.argument for rule in found if rule.id == "timed-steps") == 3
    assert {rule.of for rule in found} == set(Scope)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('"protocol-1"', '"protocol-9"'), "extends is one of"),
        (('"dt", ', '"dty", '), "without names dty, which protocol-1 does not have"),
        (('extends = "protocol-1"', ""), "without is of a rule set that extends another"),
    ],
)
def test_an_extension_that_cannot_be(change: tuple[str, str], message: str) -> None:
    """Say what is wrong with what is extended, or left out."""
    with pytest.raises(UsageError, match=message):
        parse_rules(_EXTENDS.replace(*change), "mine.toml")


@pytest.mark.parametrize("rule", [rule for rule in RULES.rules if rule.of is not Scope.file], ids=lambda rule: rule.id)
def test_rules_of_sets_need_no_open_file(rule: Rule) -> None:
    """Evaluate what rules of sets and points ask of a run that was read and closed as of the open recording."""
    recording = Recording(ROOT / "recordings" / "h100" / "mjx-jax-inclined-collision-n16-r0.mcap")
    kept, opened = _shell(read_run(recording, 5.0)), _shell(recording)
    assert fact_of(rule.fact, kept) == fact_of(rule.fact, opened)
    assert [applies(name, kept) for name in rule.when] == [applies(name, opened) for name in rule.when]
