"""The conformance suite: each kind of defect is caught by the check that is meant for it, and the command says so."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.recorder.abilities import Ability
from gpusimbench.recorder.conformance import CHECKS, NotApplicable, Subject, conformance_scene
from gpusimbench.recorder.conformance.checks.motion import turn_between
from gpusimbench.recorder.conformance.scene import N_STEP, UPPER
from gpusimbench.recorder.conformance.verdict import expect_close
from gpusimbench.recorder.scenes.registry import SCENES, make_scene
from gpusimbench.recorder.simulators.flight import HostFlight
from gpusimbench.recorder.simulators.mujoco.simulator import MujocoC, MujocoOptions
from gpusimbench.recorder.simulators.registry import Entry
from gpusimbench.schemas.commands import SCHEMA_VERSION
from tests.conftest import distribution, finished
from tests.recorder import broken_adapters as broken

ROOT = Path(__file__).resolve().parent.parent.parent
GUIDE = ROOT / "docs" / "your-simulator.md"
CHECK = {check.__name__: check for check in CHECKS}
ONLY_REGISTERED = {
    "run_is_recorded_whole",
    "recording_says_what_it_is_of",
    "timed_steps_lead_where_captured_ones_do",
}


BROKEN = [
    (broken.Xyzw, "first_state_is_the_scenes", r"first orientation of ball: expected \(1, 0, 0, 0\)"),
    (broken.Xyzw, "turns_counter_clockwise", "turn per step of stone"),
    (broken.BodyFrame, "first_state_is_the_scenes", "first angular_velocity of stone"),
    (
        broken.BodyFrame,
        "angular_velocity_is_in_the_world_frame",
        "angular velocity of stone: expected .* rad/s within 0.005",
    ),
    (broken.LeftHanded, "turns_counter_clockwise", "turn per step of stone"),
    (broken.Unnormalised, "quaternions_are_normalised", "norm of the quaternion of ball: expected 1"),
    (broken.Weightless, "free_flight_follows_gravity", "velocity of stone"),
    (broken.StandardGravity, "free_flight_follows_gravity", "velocity of stone"),
    (broken.Drifting, "stack_at_rest_stays", "position of lower_cube at rest"),
    (broken.NotANumber, "states_are_finite", "flying/linear_velocity of stone is not finite at step 20 in env 0"),
    (broken.NotANumber, "free_flight_follows_gravity", "found .*nan"),
    (broken.StepsWhileBuilding, "first_state_is_the_scenes", "first position of ball"),
    (broken.StepsWhileCompiling, "compile_moves_nothing", "compile changes balls/position"),
    (broken.EnvsApart, "envs_start_alike", "balls/position of envs 1 and 0 starts differently, by 1e-09"),
    (
        broken.OtherOrigin,
        "first_state_is_the_scenes",
        r"of env 1 are \(-10, 0, 0\) m from the scene's: env_origins say that its origin is \(5, 0, 0\), and the "
        r"bodies stand as if it were \(-5, 0, 0\)",
    ),
    (broken.OtherOrigin, "registered_scenes_start_as_described", "scene inclined-collision: all positions of env 1"),
    (
        broken.NoOrigins,
        "first_state_is_the_scenes",
        r"env 1 are \(-5, 0, 0\) m .* its origin is \(0, 0, 0\), and the bodies stand as if it were \(-5, 0, 0\)",
    ),
    (
        broken.OriginTwice,
        "first_state_is_the_scenes",
        r"env 1 are \(-5, 0, 0\) m .* frame is 'env', which has no origin in it .*\(-5, 0, 0\)\): subtract the origin",
    ),
    (broken.OtherFrame, "layout_is_as_the_format_asks", "balls/position: frame is 'world' or 'env', not 'body'"),
    (broken.EndlessOrigin, "says_what_it_is", "env_origins are not all finite"),
    (broken.FallsAside, "stack_at_rest_stays", "position of lower_cube at rest"),
    (broken.OtherUnit, "layout_is_as_the_format_asks", "unit is 'rad/s', not 'deg/s'"),
    (broken.OtherDtype, "layout_is_as_the_format_asks", "as float32, not float64"),
    (broken.OtherOrder, "layout_is_as_the_format_asks", "in the scene's order"),
    (broken.Silent, "says_what_it_is", "timing_covers is empty"),
    (broken.Gated, "gates_stay_silent", "contacts were dropped"),
    (broken.MisnamedCounter, "evidence_has_a_row_for_every_step", r"counts \['constraint_rows'\]; declared are"),
    (broken.TooFewRows, "evidence_has_a_row_for_every_step", r"\(1, 3\), not \[row, env\] = \(30, 3\)"),
    (broken.NoContacts, "contacts_hold_up_the_stack", "2 contacts in one env; two cubes at rest have at least 6"),
    (
        broken.StaleCounts,
        "contacts_change_when_a_pebble_lands",
        "10 contacts at each of the first 20 steps",
    ),
    (broken.LateCounts, "counts_agree_step_by_step", r"contacts of step 1: \[10 10 10\] by states, \[5 5 5\] by step"),
    (broken.Overflowing, "overflow_stays_silent", "overflow: NARROWPHASE"),
    (broken.UnknownBit, "overflow_stays_silent", "not declared: 0x20"),
    (
        broken.FullBuffer,
        "buffers_are_larger_than_what_they_held",
        "nconmax has 10 entries per env; 10 contacts were counted",
    ),
    (broken.UnmeasuredBuffer, "buffers_are_measured", "does not say how its size came about"),
    (broken.StepsOtherwise, "step_and_states_agree", "after 50 steps, step and states differ in balls/position"),
    (broken.Overwriting, "captured_states_stay", "its next call changed: balls/position"),
    (broken.OneSlot, "blocks_ahead_are_the_same", "blocks begun ahead give other states than one after another"),
    (
        broken.OneStepBehind,
        "flights_hold_the_captured_states",
        "holds other states than states.. gives, in balls/position",
    ),
    (broken.LooksElsewhere, "flights_hold_the_captured_states", "finds the first failures"),
    (broken.OtherActions, "actions_are_those_drawn", "applied.. after step 2 differs from the targets drawn"),
    (broken.OwnActions, "actions_are_those_drawn", "applied.. after step 4 differs from the targets drawn"),
    (broken.FirstEnvOnly, "actions_are_those_drawn", "two environments with different targets moved alike"),
    (broken.ForgetsTheWarmStart, "restored_state_repeats", "12 steps after restore are not those after snapshot"),
    (broken.LosesItsStart, "restored_before_compile_repeats", "restore before compile does not bring back"),
    (
        broken.WarmsUpAgain,
        "restored_before_compile_repeats",
        "12 steps after restore and compile are not those after snapshot",
    ),
    (broken.RestoresAll, "restoring_some_leaves_others", "restore of some changes others: balls/position"),
    (broken.ResetKeepsSpeeds, "reset_is_a_fresh_start", "reset does not bring back the first balls/linear_velocity"),
    (broken.ResetKeepsTheWarmStart, "reset_is_a_fresh_start", "steps after reset are not those of a fresh build"),
    (broken.ResetsAll, "resetting_some_leaves_others", "reset of some changes others: balls/position"),
    (broken.SetsPosesOnly, "set_state_is_shown", "linear_velocity after set_state: expected"),
    (broken.LosesItsStart, "set_state_is_shown", "linear_velocity after set_state: expected"),
    (broken.SetsNothingElse, "set_state_starts_afresh", "earlier steps leave traces behind set_state"),
    (broken.ClaimsTooMuch, "claims_are_kept", r"snapshot is claimed to be complete, and there is no snapshot\(\)"),
    (
        broken.FirstEnvsMasses,
        "varied_envs_are_those_of_their_scenes",
        "'left' of environment 1, which has parameters of",
    ),
    (
        broken.FirstEnvsSizes,
        "varied_envs_are_those_of_their_scenes",
        "of environment 1, which has parameters of its own",
    ),
    (broken.MassesAlone, "varied_envs_are_those_of_their_scenes", "of environment 0, which has parameters of its own"),
    (broken.AllAlike, "varied_envs_are_those_of_their_scenes", "of environment 0, which has parameters of its own"),
    (broken.SaysNotWhatIsMissing, "claims_are_kept", "reset is partial: say why"),
]


@pytest.mark.parametrize(("adapter", "check", "message"), BROKEN, ids=lambda x: getattr(x, "__name__", None))
def test_a_defect_is_caught(adapter: type[MujocoC], check: str, message: str) -> None:
    """Fail the check that is meant for the defect, saying what was expected and found."""
    with pytest.raises(AssertionError, match=message):
        CHECK[check](Subject(adapter))


@pytest.fixture(scope="module")
def sound() -> Subject:
    """MuJoCo C as it is, under no name."""
    return Subject(MujocoC)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_what_is_sound_passes(sound: Subject, check: Any) -> None:
    """Pass all checks without being registered, or say which need that."""
    try:
        check(sound)
    except NotApplicable as reason:
        if check.__name__ in ONLY_REGISTERED:
            assert "not registered" in str(reason)  # noqa: PT017
        else:
            assert check.__name__ in {
                "buffers_are_larger_than_what_they_held",
                "blocks_ahead_are_the_same",
                "flights_hold_the_captured_states",
            }
    else:
        assert check.__name__ not in ONLY_REGISTERED


@pytest.fixture(scope="module", params=[broken.Apart, broken.ApartAndRelative], ids=["world", "env"])
def apart(request: pytest.FixtureRequest) -> Subject:
    """MuJoCo C with environments 5 m and 10 km away, in float32."""
    return Subject(request.param)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_environments_may_stand_anywhere(apart: Subject, check: Any) -> None:
    """Pass all checks with origins, in either frame; skip what is skipped without."""
    try:
        check(apart)
    except NotApplicable as reason:
        assert "not deterministic" not in str(reason)  # noqa: PT017
        assert check.__name__ in ONLY_REGISTERED | {
            "buffers_are_larger_than_what_they_held",
            "blocks_ahead_are_the_same",
            "flights_hold_the_captured_states",
        }


def test_flights_of_environments_that_stand_apart() -> None:
    """Measure from its origin how far an environment's bodies are."""

    class Flying(broken.Apart):
        def flight(self, watch):
            return HostFlight(self, watch)

    class FromTheWorlds(broken.Apart):
        def flight(self, watch):
            return HostFlight(self, replace(watch, origins=None))

    CHECK["flights_hold_the_captured_states"](Subject(Flying))
    with pytest.raises(AssertionError, match="finds the first failures"):
        CHECK["flights_hold_the_captured_states"](Subject(FromTheWorlds))


@pytest.mark.parametrize("displaced", [0.02, -5.0], ids=lambda x: f"{x:g}")
def test_far_away_a_wrong_origin_is_still_seen(displaced: float) -> None:
    """Find an origin that is wrong by the length of a cube at 10 km, where float32 has steps of a millimetre."""

    class Displaced(broken.Apart):
        def said(self):
            return tuple((x, y + displaced * (y > 0), z) for x, y, z in super().said())

    with pytest.raises(AssertionError, match="all positions of env 2 are "):
        CHECK["first_state_is_the_scenes"](Subject(Displaced))


def test_a_ball_that_slides_does_not_roll() -> None:
    """Tell 5/7 g sin(20 deg) from g sin(20 deg)."""
    with pytest.raises(AssertionError, match=r"expected 2\.39\d+ m/s2 .* found 3\.3"):
        CHECK["ball_rolls_down_the_slope"](Subject(MujocoC, options={"condim": "1"}))


def test_an_option_that_is_not_told() -> None:
    """Ask that what the user gave is found again in the description."""
    with pytest.raises(AssertionError, match="options that were given and that the description does not tell: cone"):
        CHECK["says_what_it_is"](Subject(broken.HidesAnOption, options={"cone": "pyramidal", "threads": "1"}))


@pytest.mark.parametrize(
    ("adapter", "message"),
    [
        (broken.NoDefaultLevel, "determinism_levels has no 'default'"),
        (broken.NoDefaultOption, "field without a default"),
    ],
)
def test_a_class_that_breaks_the_contract(adapter: type[MujocoC], message: str) -> None:
    """Look at what can be seen without building, in a subject whose own options are fine."""
    subject = Subject(MujocoC)
    subject.adapter = adapter
    with pytest.raises(AssertionError, match=message):
        CHECK["class_keeps_the_contract"](subject)


def test_a_promise_of_the_registry() -> None:
    """Hold an adapter to its abilities, and to the devices and the precision that are promised for it."""
    entry = Entry("choosy", "", "", devices=("cuda",), precision=("float32",))
    choosy = Subject(broken.Choosy, entry=replace(entry, precision=()))
    with pytest.raises(AssertionError, match="abilities that scene free-fall needs, and refuses it: no planes"):
        CHECK["registered_scenes_start_as_described"](choosy)
    with pytest.raises(AssertionError, match="device cpu is none of"):
        CHECK["says_what_it_is"](choosy)
    with pytest.raises(AssertionError, match=r"float64; the registry: \('float32',\)"):
        CHECK["layout_is_as_the_format_asks"](Subject(MujocoC, entry=entry))


def test_checks_are_chosen_by_abilities() -> None:
    """Leave out what needs an ability that the adapter does not have, and say which."""

    class OnlyBoxes(MujocoC):
        abilities = frozenset({Ability.FREE_BODIES, Ability.BOXES, Ability.PLANES})

    subject = Subject(OnlyBoxes, name="only-boxes")
    able = [name for name in SCENES if make_scene(name).needs() <= OnlyBoxes.offered(OnlyBoxes.Options())]
    assert [scene.name for scene in subject.scenes] == able
    assert "free-fall" in able and "ball-drop" not in able
    CHECK["registered_scenes_start_as_described"](subject)
    with pytest.raises(NotApplicable, match="cannot simulate scene 'conformance': it has no spheres"):
        CHECK["ball_rolls_down_the_slope"](subject)
    with pytest.raises(NotApplicable, match="any built-in scene with actions needs"):
        CHECK["actions_are_those_drawn"](subject)
    OnlyBoxes.abilities = frozenset()
    with pytest.raises(NotApplicable, match="any built-in scene needs"):
        CHECK["registered_scenes_start_as_described"](subject)


def test_an_engine_that_varies_is_told_apart() -> None:
    """Skip what cannot be asked of an engine that does not repeat itself, and say so."""
    builds = itertools.count()

    class Varying(broken.Spoiled):
        def build(self):
            self.number = next(builds)
            return super().build()

        def spoil(self, field, array, step):
            return array + 1e-12 * self.number * np.asarray(step)

    subject = Subject(Varying)
    with pytest.raises(NotApplicable, match="not deterministic from run to run on cpu"):
        CHECK["step_and_states_agree"](subject)
    with pytest.raises(NotApplicable, match="not deterministic"):
        CHECK["counts_agree_step_by_step"](subject)
    assert next(builds) == 3, "a third build, and no more, is made to find out"


def test_few_builds() -> None:
    """Build the conformance scene four times for all checks of an engine that repeats itself."""
    built = []

    class Counted(MujocoC):
        def build(self):
            built.append(self.scene.name)
            return super().build()

    subject = Subject(Counted)
    for check in CHECKS:
        try:
            check(subject)
        except NotApplicable:
            continue
    assert (built.count("conformance"), built.count("varied")) == (4, 3)
    assert set(built) == {"conformance", "varied", *SCENES}
    assert len(built) == 4 + len(SCENES) + 1 + 3


def test_a_build_that_fails_is_not_tried_again() -> None:
    """Fail every check that needs the build with the one error that there was."""
    built = []

    class Failing(MujocoC):
        def build(self):
            built.append(1)
            raise RuntimeError("no such device")

    subject = Subject(Failing)
    for name in ("says_what_it_is", "states_are_finite"):
        with pytest.raises(RuntimeError, match="no such device"):
            CHECK[name](subject)
    assert len(built) == 1


def test_importing_an_engine_too_early(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catch an adapter that imports its engine at the top, and one that only looks whether it is there."""
    head = (
        "from importlib.util import find_spec\nfrom gpusimbench.recorder.simulators.mujoco.simulator import MujocoC\n"
    )
    (tmp_path / "early.py").write_text(head + "import mujoco\nclass Early(MujocoC): pass\n")
    (tmp_path / "hidden.py").write_text(
        head + "try:\n    import jax.numpy\nexcept ImportError:\n    pass\nclass Hidden(MujocoC): pass\n"
    )
    (tmp_path / "good.py").write_text(head + "THERE = find_spec('mujoco')\nclass Good(MujocoC): pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(sys.modules, "jax", None)  # not needed to make the class
    from early import Early  # type: ignore[import-not-found]
    from good import Good  # type: ignore[import-not-found]
    from hidden import Hidden  # type: ignore[import-not-found]

    check = CHECK["importing_needs_no_engine"]
    with pytest.raises(AssertionError, match="importing early imports mujoco; expected no engine before build"):
        check(Subject(Early))
    with pytest.raises(AssertionError, match="importing hidden imports jax"):
        check(Subject(Hidden))
    check(Subject(Good))


def test_the_scene_keeps_its_bodies_apart() -> None:
    """Let nothing but ball, pebble and stack touch anything, and keep the ball on its slope, for all steps."""
    trajectory = Subject(MujocoC).trajectory
    assert len(trajectory.states[0]) == N_STEP + 1
    ball = trajectory.of("ball", "position")[:, 0]
    assert ball[:, 0].min() > -0.8
    assert ball[:, 0].max() < -0.45
    assert min(trajectory.of(name, "position")[..., 2].min() for name in ("stone", "marble")) > 0.9
    scene = conformance_scene()
    alone = replace(scene, bodies=tuple(b for b in scene.bodies if b.fixed or b.name.endswith("cube")))
    simulator = MujocoC(alone, n_env=1, dt=scene.dt, seed=0, options=MujocoOptions())
    description = simulator.build()
    states = simulator.states(N_STEP)
    index = [f.name for f in description.fields].index("cubes/position")
    upper = trajectory.of(UPPER, "position")[1:, 0]
    assert np.allclose(states[index][:, 0, 1], upper, atol=1e-6), "the stack is disturbed by another body"


def test_turns_are_as_defined() -> None:
    """Turn by a right angle about z: counter-clockwise, whatever the sign of the quaternions."""
    half = np.sqrt(0.5)
    start, end = np.array([1.0, 0.0, 0.0, 0.0]), np.array([half, 0.0, 0.0, half])
    for sign in (1.0, -1.0):
        assert np.allclose(turn_between(start, sign * end), (0.0, 0.0, np.pi / 2))
    assert np.allclose(turn_between(end, end), 0.0)


def test_a_comparison_says_where() -> None:
    """Name step and environment of the largest difference; not-a-number is the largest of all."""
    found = np.zeros((4, 2, 3))
    found[2, 1] = (0.0, 0.5, 0.0)
    with pytest.raises(
        AssertionError, match=r"x: expected \(0, 0, 0\) m within 0.1, found \(0, 0.5, 0\) \(step 2, env 1\)"
    ):
        expect_close(found, 0.0, atol=0.1, what="x", unit="m")
    found[3, 0, 0] = np.nan
    with pytest.raises(AssertionError, match=r"found \(nan, 0, 0\) \(step 3, env 0\)"):
        expect_close(found, 0.0, atol=0.1, what="x", unit="m")


def conformance(*arguments: str, code: int | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    words = [sys.executable, "-m", "gpusimbench.recorder.conformance", *arguments]
    return finished(words, code=code, env={**os.environ, **environment})


def test_the_command() -> None:
    """Print a line a check and a tally, and end with 0 where none failed."""
    done = conformance("--sim", "mujoco", "--option", "cone=pyramidal", code=0)
    lines = done.stdout.splitlines()
    assert len(lines) == len(CHECKS) + 1
    assert "ok      free_flight_follows_gravity" in lines
    assert any(line.startswith("skipped buffers_are_larger_than_what_they_held: ") for line in lines)
    assert re.fullmatch(r"mujoco: \d+ ok, 0 failed, 3 skipped", lines[-1])


def test_the_command_for_programs() -> None:
    """Print JSON alone, and end with 1 where a check failed."""
    done = conformance("--sim", "mujoco", "--option", "condim=1", "--json", code=1)
    record = json.loads(done.stdout)
    assert (record["simulator"], record["options"]) == ("mujoco", {"condim": "1"})
    assert record["schema_version"] == SCHEMA_VERSION
    failed = {v["check"]: v["reason"] for v in record["checks"] if v["outcome"] == "failed"}
    assert "acceleration of the ball" in failed["ball_rolls_down_the_slope"]
    assert [v["check"] for v in record["checks"]] == list(CHECK)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--sim", "abacus"), "there is no simulator 'abacus'"),
        (("--sim", "mujoco", "--option", "colour=red"), "has no option 'colour'"),
        (("--sim", "mujoco", "--determinism", "total"), "has no determinism level 'total'; it has: default"),
        ((), "--sim"),
    ],
)
def test_what_cannot_be_checked(arguments: tuple[str, ...], message: str) -> None:
    """Say what is wrong, print no result, and end with 2."""
    done = conformance(*arguments, code=2)
    assert message in done.stderr
    assert not done.stdout


@pytest.fixture
def registered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a distribution that offers adapters of this module, for this process and those that it starts."""
    names = "".join(
        f"{a.__name__.lower()} = {a.__module__}:{a.__name__}\n"
        for a in (broken.Gated, broken.StepsOtherwise, broken.Silent)
    )
    distribution(tmp_path, "broken", f"[gsb.simulators]\n{names}")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), str(ROOT)]))
    yield tmp_path


@pytest.mark.parametrize(
    ("name", "check", "message"),
    [
        ("gated", "run_is_recorded_whole", "ball-drop ends invalid: phase warmup: contacts were dropped"),
        ("stepsotherwise", "timed_steps_lead_where_captured_ones_do", r"differ at steps \[1, 4\]"),
    ],
)
def test_a_defect_shows_in_a_recording(registered: Path, name: str, check: str, message: str) -> None:
    """Catch what only a recording of a registered adapter shows."""
    with pytest.raises(AssertionError, match=message):
        CHECK[check](Subject.named(name))


@pytest.mark.slow
def test_a_third_partys_adapter_by_the_command(registered: Path) -> None:
    """Check an adapter that a distribution adds; one defect is one line."""
    done = conformance("--sim", "silent", code=1)
    failed = [line for line in done.stdout.splitlines() if line.startswith("FAILED")]
    assert failed == ["FAILED  says_what_it_is: the description's timing_covers is empty"]


def _guide(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


@pytest.mark.slow
def test_the_guides_adapter_is_checked_as_shown(tmp_path: Path) -> None:
    """Find of the guide's adapter what the guide says, from pytest and in the words that it shows."""
    (adapter,) = _guide("python")
    (tests,) = _guide("py")
    (shown,) = _guide("text")
    (tmp_path / "ballistic.py").write_text(adapter)
    (tmp_path / "test_ballistic.py").write_text(tests)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-rfs", "--rootdir", str(tmp_path), str(tmp_path)],
        cwd=tmp_path, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    failed = re.findall(r"^FAILED test_ballistic\.py::test_conforms\[(\w+)\]", done.stdout, re.MULTILINE)
    assert failed == re.findall(r"^FAILED  (\w+)", shown, re.MULTILINE), done.stdout
    distribution(tmp_path, "ballistic", "[gsb.simulators]\nballistic = ballistic:Ballistic\n")
    printed = conformance("--sim", "ballistic", PYTHONPATH=str(tmp_path)).stdout.splitlines()
    for line in shown.splitlines():
        assert line in printed, "\n".join(printed)
