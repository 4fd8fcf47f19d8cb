"""gsb-probe: questions about what should not matter, asked of recordings that differ in it alone."""

from __future__ import annotations

import io
import json
import os
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.levels import EqualityLevel
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.probe.arms import arms_of
from gpusimbench.evaluator.probe.finding import Answer, Finding, verdict_of
from gpusimbench.evaluator.probe.pairs import Pairs, _measured, compare_pairs
from gpusimbench.evaluator.probe.questions import QUESTIONS, answers
from gpusimbench.evaluator.probe.questions import probed as judged
from gpusimbench.evaluator.probe.runs import Arm, Plan, arm_of, interleaved
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.render.document import Section
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.brief import brief
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.sections.probed import depends, evidence
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.schemas import topics
from gpusimbench.schemas.commands.folder_lock import folder_lock as held_by
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.fields import body_fields, joint_field
from gpusimbench.schemas.initial import Initial
from gpusimbench.schemas.location import place
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PROVENANCE, SCENE, SIMULATION
from gpusimbench.schemas.symmetry import Mirror
from gpusimbench.schemas.treatment import Intervention
from tests.conftest import Command, call, made_once
from tests.synthetic import Shown, changing, grid, write_recording

Planted = Callable[[NDArray[Any], int], None]
"""Changes the positions [env, 27, 3] after a step."""

PLAN = Plan("synthetic", "inclined-collision", "default", (), 0, 30, 4, (1, 2, 8), 0.25)
AT = PLAN.steps // 3


def _who(env: int, n_env: int, initial: str) -> int:
    # a number for each initial state that can be drawn
    if not initial:
        return 0
    drawn = Initial.parse(initial)
    other = 100 if drawn.but not in (None, env) else 0
    return other + (env + drawn.shift) % n_env + 1


def _world(arm: Arm, planted: Planted | None) -> Callable[[NDArray[Any], int], NDArray[Any]]:
    """Positions of a simulator on which nothing depends that should not: each body moves by who it is, and by steps."""
    done = Intervention.of(arm.intervention)

    def positions(start: NDArray[Any], step: int) -> NDArray[Any]:
        found = start.copy()
        for env in range(arm.n_env):
            who, age = _who(env, arm.n_env, arm.initial), step
            changed = done is not None and step > done.step and env in done.treated(arm.n_env)
            if done is not None and changed and done.kind.restarts:
                who, age = 0, step - done.step
            if done is not None and changed and done.kind.poisons:
                found[env] = np.nan
                continue
            found[env] += np.float32(0.001) * age * np.sin(np.arange(27, dtype=np.float32) + who)[:, None]
        for at, axis in enumerate("xyz"):
            if arm.initial and axis in Initial.parse(arm.initial).mirror:
                found[..., at] = -found[..., at]
        if arm.initial and Initial.parse(arm.initial).relabel:
            found = found[:, ::-1].copy()
        if planted is not None:
            planted(found, step)
        return found

    return positions


def _write(
    folder: Path, arm: Arm, planted: Planted | None = None, switches: dict[str, Any] | None = None,
    also: Callable[[str, dict[str, Any]], None] = lambda name, record: None, **keywords: Any,
) -> Recording:  # fmt: skip
    def treated(name: str, record: dict[str, Any]) -> None:
        if name == PROVENANCE:
            record["configuration"] |= {"initial": arm.initial, "intervention": arm.intervention}
        if name == SIMULATION:
            record["switches"] |= switches or {}
        also(name, record)

    folder.mkdir(exist_ok=True)
    start = grid(arm.n_env, "float32")
    moved = _world(arm, planted)
    path = write_recording(
        folder, moved(start, PLAN.steps), steps=PLAN.steps, dt=0.01, elapsed_s=None, change=treated,
        path_of=lambda _, step: moved(start, step), begins=moved(start, 0), **keywords,
    )  # fmt: skip
    return Recording(place(str(path)))


def _probe(folder: Path, planted: dict[int, Planted] | None = None) -> dict[str, Finding]:
    """Answers to recordings of the plan, in a scene without a slope; `planted` by place in it."""
    recordings = [_write(folder, arm, (planted or {}).get(at), scene="free-fall") for at, arm in enumerate(ARMS)]
    (arms,) = arms_of(recordings)
    return {finding.key: finding for finding in answers(arms)}


def _moved(env: int, body: int, step: int, ulps: int = 1) -> Planted:
    def plant(positions: NDArray[Any], now: int) -> None:
        if now >= step:
            word = positions[env, body, 1].view(np.int32) + np.int32(ulps)
            positions[env, body, 1] = word.view(np.float32)

    return plant


ARMS = [arm for arm in PLAN.arms() if not arm.snapshot and not arm.continued]
"""plain, usual, 1, 2 and 8 environments, shifted, all but one, mirrored, turned, relabelled, one a kind of
intervention, usual, plain."""

TREATED = {done.name: at for at, arm in enumerate(ARMS) if (done := Intervention.of(arm.intervention))}
MIRRORED, TURNED = (at for at, arm in enumerate(ARMS) if "mirror" in arm.initial)
RELABELLED = next(at for at, arm in enumerate(ARMS) if "relabel" in arm.initial)
USUAL_AGAIN, PLAIN_AGAIN = len(ARMS) - 2, len(ARMS) - 1


def test_nothing_planted(tmp_path: Path) -> None:
    """Answer yes to everything that was recorded, where nothing depends on anything."""
    found = _probe(tmp_path)
    assert [q.key for q in QUESTIONS if not q.asked_of_few] == list(found)
    others = {"capture", "process"}
    yes = len(found) - len(others)
    assert {key for key, finding in found.items() if finding.answer is Answer.YES} == found.keys() - others
    assert {found[key].answer for key in others} == {Answer.NOT_ASKED}
    assert verdict_of(list(found.values())) == f"{yes} of {yes} answers are yes"
    runs, envs, *others = (one.title for one in found.values() if one.answer is Answer.YES)
    of_two = f"{yes} of {yes} answers are yes ({runs}, {envs} and {len(others)} more)"
    assert verdict_of(list(found.values()), named=2) == of_two
    assert verdict_of([found["runs"]], named=2) == f"1 of 1 answer is yes ({found['runs'].title})"
    no = replace(found["runs"], answer=Answer.NO)
    assert verdict_of([no]) == f"0 of 1 answer is yes; no: {no.title}"
    assert verdict_of([found["capture"]], named=2) == "no question of gsb-probe has the runs that it compares"
    assert evidence(found["number"]) == "bit-identical: 7 pairs, 31 steps"
    # two runs agreed with the first of their arm: 1 - 0.05^(1/2)
    assert evidence(found["runs"]).endswith("one more run differs with a probability below 78 % (95 % confidence)")
    assert evidence(found["fresh"]) == f"bit-identical: 2 pairs, {PLAN.steps - AT} steps"


@pytest.mark.parametrize(
    ("index", "env", "step", "also", "env_a"),
    [
        (USUAL_AGAIN, 2, 7, "runs", 2),
        (0, 3, 9, "envs", 0),
        (3, 1, 5, "number", 1),
        (5, 1, 4, "slot", 2),
        (6, 0, 6, "neighbours", 0),
        (MIRRORED, 3, 8, "mirrored", 3),
        (TURNED, 1, 6, "turned", 1),
        (RELABELLED, 2, 9, "relabelled", 2),
        (TREATED["poison"], 2, AT + 2, "poison", 2),
        (TREATED["reset"], 1, AT + 2, "bystanders", 1),
        (TREATED["reset"], 2, AT + 3, "fresh", 2),
        (TREATED["excursion"], 3, AT + 1, "restored", 3),
        (TREATED["set"], 0, AT + 1, "set", 0),
    ],
)
def test_one_thing_planted(tmp_path: Path, index: int, env: int, step: int, also: str, env_a: int) -> None:
    """Say no to the question that the planted unit in the last place is about: where, and by how much."""
    # of runs that are alike, both are alike, unless that is what the question is about
    found = _probe(tmp_path, {at: _moved(env, 5, step) for at in ((0, PLAIN_AGAIN) if index == 0 else (index,))})
    asked = found[also]
    # where runs differ anyway, a difference has no known cause
    others = {Answer.YES, Answer.NOT_ASKED} | ({Answer.OPEN} if also == "runs" else set())
    assert asked.answer is Answer.NO
    assert {finding.answer for key, finding in found.items() if key != also} <= others
    assert asked.found is not None
    assert asked.found.level is EqualityLevel.WITHIN_ULP
    assert asked.found.first_step == step
    first = asked.found.first
    assert first is not None
    assert (first.step, first.env_a, first.field, first.component, first.ulp) == (step, env_a, "cubes/position", "y", 1)
    assert first.item.startswith("cube")
    assert "first by 1 ULP" in evidence(asked)
    assert "never beyond 8 ULP" in evidence(asked)


def test_a_sign_planted(tmp_path: Path) -> None:
    """Say that signs differ where they do, and no number of ULPs, which would be a number near 2^32."""

    def turned(positions: NDArray[Any], now: int) -> None:
        if now >= 4:
            positions[1, 5, 1] *= -1

    asked = _probe(tmp_path, {0: turned})["runs"]
    assert asked.found is not None and asked.found.first is not None
    assert asked.found.first.signs_differ and asked.found.first.ulp > 2**30
    said = evidence(asked)
    assert "first by opposite signs (env 1, cube" in said
    assert "ULP" not in said


@pytest.mark.parametrize(
    ("index", "key", "words"),
    [(MIRRORED, "mirrored", "mirrored in the plane y = 0"), (TURNED, "turned", "turned by a half turn about z")],
)
def test_mirror_images(tmp_path: Path, index: int, key: str, words: str) -> None:
    """Compare images with the mirrored or turned run: zeros have no sign, and everything else counts."""

    def zeros(sign: float) -> Planted:
        def plant(positions: NDArray[Any], now: int) -> None:
            positions[2, 3] = sign * 0.0

        return plant

    arms = {at: zeros(-1.0) for at in (1, USUAL_AGAIN)} | {index: zeros(-1.0)}
    asked = _probe(tmp_path / "zeros", arms)[key]
    assert asked.answer is Answer.YES
    assert evidence(asked) == f"bit-identical: {PLAN.n_env} pairs, {PLAN.steps + 1} steps"
    assert asked.compared == f"the same initial states, {words}"

    def unmirrored(positions: NDArray[Any], now: int) -> None:
        if now >= 5:
            positions[1, 7, 1] *= -1

    found = _probe(tmp_path / "sides", {index: unmirrored})[key]
    assert found.answer is Answer.NO and found.found is not None and found.found.first is not None
    assert (found.found.differing, found.found.first_step, found.found.first.signs_differ) == (1, 5, True)


def _why_not_asked(key: str, *recordings: Recording) -> str:
    (arms,) = arms_of(recordings)
    (found,) = (finding for finding in answers(arms) if finding.key == key)
    assert found.answer is Answer.NOT_ASKED
    return found.reason


def test_mirror_images_that_are_not_asked(tmp_path: Path) -> None:
    """Say why, of old recordings without the arm, of a scene that has another mirror image, and of origins."""
    usual, mirrored = ARMS[1], ARMS[MIRRORED]
    reason = partial(_why_not_asked, "mirrored")

    tilted = changing(SCENE, gravity=[0.0, 1.0, -9.81])
    assert reason(_write(tmp_path, usual)) == "needs a run with --initial random:SPREAD,mirror:y"
    both = [_write(tmp_path / "tilted", arm, also=tilted) for arm in (usual, mirrored)]
    why = "the scene is not its own mirror image: gravity is not along z"
    assert reason(*both) == reason(both[0]) == why
    across = [_write(tmp_path / "across", arm) for arm in (usual, replace(mirrored, initial="random:0.25,mirror:x"))]
    why = "the scene is not its own mirror image: no fixed body is the mirror image of 'board'"
    assert reason(*across) == why
    half = [_write(tmp_path / "half", arm) for arm in (usual, ARMS[TURNED])]
    why = "the scene is not its own half-turn image: no fixed body is the half-turn image of 'board'"
    assert _why_not_asked("turned", *half) == _why_not_asked("turned", half[0]) == why
    level = _write(tmp_path / "level", usual, scene="free-fall")
    assert _why_not_asked("turned", level) == "needs a run with --initial random:SPREAD,mirror:xy"
    assert reason(*half) == "needs a run with --initial random:SPREAD,mirror:y"
    for axis, apart in ((0, False), (1, True)):
        origins = tuple(tuple(4.0 * env * (at == axis) for at in range(3)) for env in range(PLAN.n_env))
        one, other = (_write(tmp_path / str(axis), arm, origins=origins) for arm in (usual, mirrored))
        found = compare_pairs(Pairs(one, other, ((1, 1),), symmetry=Mirror("y")))
        assert isinstance(found, Missing) == apart
        assert not apart or "beside the mirror's plane" in str(found)


def test_identical_bodies(tmp_path: Path) -> None:
    """Compare each body with the identical one whose state it began with: of others, nothing is equal, not even a zero
    with a zero of the other sign."""
    asked = _probe(tmp_path / "alike")["relabelled"]
    assert asked.answer is Answer.YES
    assert evidence(asked) == f"bit-identical: {PLAN.n_env} pairs, {PLAN.steps + 1} steps"
    assert asked.compared == "the same initial states, exchanged between identical bodies, in reverse order"

    def back(positions: NDArray[Any], now: int) -> None:
        if now >= 5:
            positions[1] = positions[1, ::-1].copy()

    found = _probe(tmp_path / "names", {RELABELLED: back})["relabelled"].found
    assert found is not None and found.first is not None
    assert (found.differing, found.first_step, found.first.env_a) == (1, 5, 1)

    def zeros(body: int, sign: float) -> Planted:
        def plant(positions: NDArray[Any], now: int) -> None:
            positions[2, body] = sign * 0.0

        return plant

    for sign, answer in ((1.0, Answer.NO), (-1.0, Answer.YES)):
        arms = {at: zeros(3, -1.0) for at in (1, USUAL_AGAIN)} | {RELABELLED: zeros(27 - 1 - 3, sign)}
        assert _probe(tmp_path / f"zeros {sign}", arms)["relabelled"].answer is answer


def test_identical_bodies_that_are_not_asked(tmp_path: Path) -> None:
    """Say why: of old recordings without the arm, of scenes without identical bodies, of bodies that vary."""
    usual, relabelled = ARMS[1], ARMS[RELABELLED]
    reason = partial(_why_not_asked, "relabelled")

    old = _write(tmp_path, usual)
    assert reason(old) == "needs a run with --initial random:SPREAD,relabel:reverse"
    weights = [{**body, "mass": body.get("mass") and at + 1.0} for at, body in enumerate(old.scene["bodies"])]
    both = [_write(tmp_path / "weights", arm, also=changing(SCENE, bodies=weights)) for arm in (usual, relabelled)]
    assert reason(*both) == reason(both[0]) == "the scene has no two identical bodies that move"
    varied = changing(PROVENANCE, "configuration", vary="mass:0.1")
    both = [_write(tmp_path / "varied", arm, also=varied) for arm in (usual, relabelled)]
    assert reason(*both) == "the scene has no identical bodies: each has parameters of its own (--vary)"
    origins = tuple((0.3 * env, 0.1, 0.0) for env in range(PLAN.n_env))
    one, other = (_write(tmp_path / "origins", arm, origins=origins) for arm in (usual, relabelled))
    (arms,) = arms_of([one, other])
    assert {finding.key: finding for finding in answers(arms)}["relabelled"].answer is Answer.YES


def test_distances_are_of_one_unit() -> None:
    """Measure positions where there are any, and else the hinges; sliding joints where there are none of both."""
    bodies = body_fields({"cubes": ("a", "b")}, "float64")
    mixed = joint_field("robot", "qpos", "float64", ("hinge", "slide"), slides={"slide"})
    slides = joint_field("robot", "qpos", "float64", ("one", "other"), slides={"one", "other"})
    speeds = joint_field("robot", "qvel", "float64", ("hinge",))
    assert _measured((mixed, *bodies)) == ("m", {"cubes/position": [0, 1]})
    assert _measured((speeds, mixed)) == ("rad", {"robot/qpos": [0]})
    assert _measured((slides,)) == ("m", {"robot/qpos": [0, 1]})
    assert _measured((speeds,)) == ("", {})


def test_joints_have_no_mirror_image() -> None:
    """Say which field cannot be mirrored, before any state is read."""
    joints = joint_field("robot", "qpos", "float64", ("hinge",))
    run: Any = SimpleNamespace(fields=(joints,), configuration=SimpleNamespace(dt=0.01), simulation=None)
    found = compare_pairs(Pairs(run, run, ((0, 0),), symmetry=Mirror("y")))
    assert isinstance(found, Missing)
    assert found.reason == "the mirror image of robot/qpos is not known"


def test_far_apart(tmp_path: Path) -> None:
    """Tell small differences from large ones, and say where they are largest."""

    def fly(positions: NDArray[Any], step: int) -> None:
        if step >= 12:
            positions[3, 4, 2] += np.float32(0.01) * (15 - abs(step - 20))

    asked = _probe(tmp_path, {TREATED["excursion"]: fly})["restored"]
    assert asked.answer is Answer.NO
    assert asked.found is not None
    assert asked.found.level is EqualityLevel.DIFFERENT
    assert (asked.found.first_step, asked.found.at_step, asked.found.unit) == (12, 20, "m")
    assert asked.found.max_distance == pytest.approx(0.15)
    assert "15 cm apart at step 20" in evidence(asked)


def test_not_finite(tmp_path: Path) -> None:
    """Call numbers that are not finite different, at no known distance."""

    def blow(positions: NDArray[Any], step: int) -> None:
        if step >= 12:
            positions[3, 4, 2] = np.nan

    (one,) = arms_of([_write(tmp_path, ARMS[0], blow), _write(tmp_path, ARMS[0])])
    found = {finding.key: finding for finding in answers(one)}["runs"]
    assert found.answer is Answer.NO
    assert found.found is not None
    assert found.found.level is EqualityLevel.DIFFERENT


def test_switches_that_follow_the_number(tmp_path: Path) -> None:
    """Keep the arms together where the engine itself sets a switch by the number of environments."""
    arms = [_write(tmp_path, arm, switches={"layout": min(arm.n_env, 2), "mode": "a"}) for arm in ARMS]
    (one,) = arms_of(arms)
    assert sorted(one.by_number) == [1, 2, 8]
    others = [_write(tmp_path, arm, switches={"layout": min(arm.n_env, 2), "mode": "b"}) for arm in ARMS[:3]]
    assert [json.loads(both.key.switches)["mode"] for both in arms_of([*arms, *others])] == ["a", "b"]


def test_noise_leaves_causes_open(tmp_path: Path) -> None:
    """Blame nothing for a difference where runs of the same configuration differ, too; what is equal is still yes."""
    found = _probe(tmp_path, {USUAL_AGAIN: _moved(2, 5, 7), TREATED["excursion"]: _moved(1, 5, 12)})
    assert found["runs"].answer is Answer.NO
    assert found["restored"].answer is Answer.OPEN
    assert found["restored"].reason == "runs that were asked for the same differ too, from step 7 on"
    assert found["slot"].answer is Answer.YES
    few, away = tmp_path / "few", ARMS[TREATED["excursion"]]
    (arms,) = arms_of([_write(few, ARMS[1]), _write(few, away, _moved(1, 5, 12))])
    alone = {finding.key: finding for finding in answers(arms)}
    assert alone["restored"].answer is Answer.OPEN
    assert "runs were not compared" in alone["restored"].reason


def test_what_is_not_there_is_not_asked(tmp_path: Path) -> None:
    """Name what a question needs, and the reason where the run for it failed."""
    failed = _write(tmp_path, ARMS[TREATED["set"]], status="FAILED", reason="no room", cause="ENGINE")
    shifted = _write(tmp_path, ARMS[5], status="FAILED", reason="no time", cause="ENGINE")
    (arms,) = arms_of([_write(tmp_path, ARMS[1]), failed, shifted])
    found = {finding.key: finding for finding in answers(arms)}
    assert {finding.answer for finding in found.values()} == {Answer.NOT_ASKED}
    assert found["set"].reason == "its run is failed: no room"
    assert found["restored"].reason == "needs a run with --intervene excursion@STEP+MORE"
    assert found["slot"].reason == "its run is failed: no time"
    assert found["neighbours"].reason == "needs a run with --initial random:SPREAD,but:E"
    assert found["number"].reason == "needs runs of other numbers of environments"
    assert verdict_of(list(found.values())) == "no question of gsb-probe has the runs that it compares"


def test_at_different_origins(tmp_path: Path) -> None:
    """Compare no positions by bits that were rounded at different places, and say so."""
    origins = tuple((float(env), 0.0, 0.0) for env in range(PLAN.n_env))
    (arms,) = arms_of([_write(tmp_path, arm, origins=origins) for arm in (ARMS[1], ARMS[5], ARMS[6])])
    found = {finding.key: finding for finding in answers(arms)}
    assert found["slot"].answer is Answer.NOT_ASKED
    assert "they stand at different origins" in found["slot"].reason
    assert found["neighbours"].answer is Answer.YES


def test_what_cannot_be_compared(tmp_path: Path) -> None:
    """Say why two recordings have nothing to compare."""
    one = _write(tmp_path, ARMS[1])
    other = Recording(place(str(write_recording(tmp_path, grid(4, "float64"), steps=30, dt=0.01))))
    coarse = Recording(place(str(write_recording(tmp_path, grid(4, "float32"), steps=30, dt=0.02))))
    for there, why in ((other, "other state fields"), (coarse, "other time steps")):
        found = compare_pairs(Pairs(one, there, ((0, 0),)))
        assert isinstance(found, Missing)
        assert why in found.reason
    apart = compare_pairs(Pairs(one, one, ((0, 0),), ahead=1000))
    assert isinstance(apart, Missing)


def test_arms_are_kept_apart(tmp_path: Path) -> None:
    """Hold no run against one of another simulator, level or seed."""
    recordings = [_write(tmp_path, ARMS[1]), _write(tmp_path, ARMS[1], determinism="strict"),
                  _write(tmp_path, ARMS[1], version="2.0")]  # fmt: skip
    assert [len(arms.varied) for arms in arms_of(recordings)] == [1, 1, 1]


def test_copies_are_no_second_run(tmp_path: Path) -> None:
    """Call nothing repeatable for two files of one run."""
    one = _write(tmp_path, ARMS[1], run_id="00000000-0000-4000-8000-000000000001")
    copy = _write(tmp_path, ARMS[1], run_id="00000000-0000-4000-8000-000000000001")
    (arms,) = arms_of([one, copy])
    assert {finding.key: finding for finding in answers(arms)}["runs"].answer is Answer.NOT_ASKED


def test_other_spreads_are_other_states(tmp_path: Path) -> None:
    """Compare no run with one whose initial states were drawn from another range."""
    wider = Arm(PLAN.n_env, str(Initial(2 * PLAN.spread)))
    recordings = [_write(tmp_path, arm) for arm in (ARMS[1], ARMS[1], wider, Arm(8, wider.initial), ARMS[4])]
    (arms,) = arms_of(recordings)
    assert len(arms.varied) == 2
    assert {n: r.configuration.initial for n, r in arms.by_number.items()} == {8: ARMS[1].initial}
    found = {finding.key: finding for finding in answers(arms)}
    assert found["runs"].answer is found["number"].answer is Answer.YES


def test_a_capture_that_changes_environments(tmp_path: Path) -> None:
    """Count the environments whose state hashes differ between the phases, and not the steps at which they do."""
    start, steps = grid(4, "float32"), 4
    made = message_class("gsb.v1.FingerprintBlock")(first_step=1, stride=1, steps=steps, env_start=0, envs=4)
    plain = write_recording(tmp_path, start, steps=steps, dt=0.01, run=1)
    captured = Recording(plain).fingerprints("capture")
    assert captured is not None
    hashes = captured.hashes[np.isin(captured.steps, range(1, steps + 1))]
    assert hashes.shape == (steps, 4)
    for count, envs in enumerate(([], [2], [1, 2, 3])):
        timed = hashes.copy()
        timed[2:3, envs] ^= np.uint64(1)  # at step 3 alone
        del made.hashes[:]
        made.hashes.extend(timed.reshape(-1).tolist())
        shown = Shown(raw=((topics.fingerprint("timed"), "gsb.v1.FingerprintBlock", made),))
        run = Recording(write_recording(tmp_path, start, steps=steps, dt=0.01, run=count + 2, shown=shown))
        (arms,) = arms_of([run])
        (question,) = (one for one in QUESTIONS if one.key == "capture")
        asked = question.ask(arms)
        assert not isinstance(asked, Missing)
        assert (asked.found.differing, asked.found.pairs, asked.found.steps) == (len(envs), 4, steps)
        assert asked.found.first_step == (3 if envs else None)
        assert asked.compared == "timed and captured states, at step 1, 2, 3, 4"


def test_arms_of_other_sizes(tmp_path: Path) -> None:
    """Hold no arm against runs of another number of environments, but for the question about numbers."""
    foreign = [Arm(2, ARMS[5].initial), Arm(2, ARMS[6].initial), replace(ARMS[TREATED["reset"]], n_env=2)]
    (arms,) = arms_of([_write(tmp_path, arm) for arm in (*foreign, *ARMS[:2], *ARMS[USUAL_AGAIN:])])
    assert arms.otherwise == {}
    assert arms.treated == {}
    assert {finding.key: finding for finding in answers(arms)}["slot"].answer is Answer.NOT_ASKED


def test_a_plan_goes_on_where_it_stopped() -> None:
    """Make each arm as often as it is asked for, and no run of other plans instead."""
    done = [
        RunConfiguration(
            "synthetic", "inclined-collision", arm.n_env, 0.01, PLAN.steps,
            initial=f"{arm.initial}:{'0' * 64}" if arm.continued else arm.initial, intervention=arm.intervention,
            phases=("timed", "capture") if arm.timed else ("capture",),
            snapshots=(arm.snapshot,) if arm.snapshot else (),
        )
        for arm in PLAN.arms()
    ]  # fmt: skip
    assert PLAN.missing([]) == list(PLAN.arms())
    assert PLAN.missing(done) == []
    assert PLAN.missing(done[:1]) == [*PLAN.arms()][1:]
    assert PLAN.missing(done, again=[ARMS[6], ARMS[1]]) == [ARMS[6], ARMS[6], ARMS[1]]  # three runs of each
    foreign = RunConfiguration("synthetic", "free-fall", 4, 0.01, PLAN.steps, initial=ARMS[1].initial)
    assert len(PLAN.missing([foreign])) == len(list(PLAN.arms()))


def _probed(folder: Path) -> None:
    done = call(
        "gsb-probe", "--sim", "mujoco", "--n-env", "3", "--numbers", "1", "--steps", "30", "--out", folder / "out",
        "--json", folder / "answers.json", code=0,
    )  # fmt: skip
    assert len(done.stdout.splitlines()) <= 27
    asked = sum(not question.asked_of_few for question in QUESTIONS) - 1  # no half turns on a slope
    no = (
        "a mirrored state goes on as the mirrored one, identical bodies are interchangeable, positions and velocities "
        "are the whole state"
    )
    said = f"{asked - 3} of {asked} answers are yes; no: {no}"
    assert said in " ".join(done.stdout.split())


def of_mujoco() -> Path:
    """A probe of MuJoCo C, small; must not be written to."""
    return made_once("probe-of-mujoco", _probed)


@pytest.fixture(scope="module")
def probed() -> Path:
    """Its recordings."""
    return of_mujoco() / "out"


@pytest.mark.slow
def test_mujoco(probed: Path) -> None:
    """Find that MuJoCo C depends on nothing but the side on which boxes touch and the order of bodies, and that it has
    more of a state than positions and velocities."""
    (probe,) = json.loads((probed.parent / "answers.json").read_text())["probes"]
    assert probe["simulator"] == "mujoco"
    said = {answer["key"]: answer for answer in probe["answers"]}
    assert {key for key, answer in said.items() if answer["answer"] == "no"} == {"mirrored", "relabelled", "set"}
    assert said["set"]["found"]["first_step"] == 11
    assert said["runs"]["found"]["level"] == "bit_identical"


@pytest.mark.slow
def test_recordings_are_enough(probed: Path, gsb_probe: Command) -> None:
    """Answer the same from the recordings alone; with --gate, the last question decides nothing."""
    again = gsb_probe(probed, "--json", "-", code=0)
    assert json.loads(again.stdout) == json.loads((probed.parent / "answers.json").read_text())
    assert gsb_probe(probed, "--gate").returncode == 0
    every = gsb_probe(probed, "--all").stdout
    assert "saved at step 10, 3 further steps, restored" in " ".join(every.split())
    assert "a snapshot of step 10, restored in another process" in " ".join(every.split())


@pytest.mark.slow
def test_nothing_is_recorded_twice(probed: Path, gsb_probe: Command) -> None:
    """Go on where a probe was interrupted: what lies in the folder is not made again."""
    before = sorted(probed.iterdir())
    before[3].unlink()
    gsb_probe("--sim", "mujoco", "--n-env", "3", "--numbers", "1", "--steps", "30", "--out", probed, code=0)
    after = sorted(probed.iterdir())
    assert len(after) == len(before)
    assert len(set(after) - set(before)) == 1


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ((), "name simulators to probe with --sim, or recordings"),
        (("--sim", "mujoco", "x.mcap"), "not both"),
        (("--sim", "mujocoo"), "did you mean 'mujoco'"),
        (("--sim", "mujoco", "--numbers", "a"), "--numbers is a list"),
        (("--sim", "mujoco", "--steps", "5"), "--steps is at least 30"),
        (("--sim", "mujoco", "--determinism", "stict"), "has no determinism level 'stict'"),
    ],
)
def test_wrong_usage(arguments: tuple[str, ...], why: str, gsb_probe: Command, tmp_path: Path) -> None:
    """Say what is wrong before anything is recorded."""
    done = gsb_probe(*arguments, *(("--out", tmp_path / "out") if "--sim" in arguments else ()), code=2)
    assert why in done.stderr
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").glob("*.mcap"))


def test_recordings_that_are_no_arms(gsb_probe: Command, tmp_path: Path) -> None:
    """Say that nothing can be asked of one recording, and refuse one that is damaged."""
    path = write_recording(tmp_path, grid(1))
    assert "nothing to compare: gsb-probe needs runs of one configuration" in gsb_probe(path, code=5).stderr
    invalid = _write(tmp_path / "invalid", ARMS[0], status="INVALID", reason="a state is not finite").path
    assert f"no run ended well: {invalid} is invalid: a state is not finite" in gsb_probe(invalid, code=5).stderr
    path.write_bytes(path.read_bytes()[:-40])
    assert gsb_probe(path).returncode == 3


def test_gates(tmp_path: Path, gsb_probe: Command) -> None:
    """End with 4 where an answer is no, with 5 where one is open."""
    for index, arm in enumerate(ARMS):
        _write(tmp_path, arm, _moved(1, 5, 12) if index == TREATED["excursion"] else None)
    assert gsb_probe(tmp_path, "--gate").returncode == 4
    few = tmp_path / "few"
    _write(few, ARMS[1])
    _write(few, ARMS[TREATED["excursion"]], _moved(1, 5, 12))
    assert gsb_probe(few, "--gate").returncode == 5
    assert gsb_probe(few).returncode == 0


def test_numbers_that_differ_are_named(tmp_path: Path) -> None:
    """Say for which numbers of environments anything differs, and which could not be compared."""
    recordings = [_write(tmp_path, arm) for arm in (ARMS[1], ARMS[1], ARMS[2])]
    recordings.append(_write(tmp_path, ARMS[3], _moved(1, 7, 4)))
    recordings.append(_write(tmp_path, ARMS[4], status="INVALID", reason="buffer overflow", cause="ENGINE"))
    (arms,) = arms_of(recordings)
    found = {finding.key: finding for finding in answers(arms)}["number"]
    assert found.answer is Answer.NO
    assert found.detail == "differs for 2 environments; not with 8: invalid: buffer overflow"
    assert found.detail in evidence(found)


RECORDINGS = Path(__file__).resolve().parents[2] / "recordings"
SHIPPED = sorted([*RECORDINGS.glob("probe/mjx-run*.mcap"), *RECORDINGS.glob("probe-h100/newton-xpbd-run*.mcap")])


@pytest.fixture(scope="module")
def evaluated() -> Evaluation:
    """What gsb-eval makes of two probes on a GPU."""
    return evaluate_files([place(str(path)) for path in SHIPPED])


def test_probes_on_a_gpu(evaluated: Evaluation) -> None:
    """Two engines repeat themselves and depend on the number of environments; hashes answer where no states are."""
    found = {one.arms.key.simulator: {f.key: f for f in one.findings} for one in evaluated.probed}
    assert set(found) == {"mjx", "newton"}
    for answered in found.values():
        assert {key for key, f in answered.items() if f.answer is Answer.NO} - {"set"} == {"number"}
        fresh = answered["fresh"].found
        assert fresh is not None
        assert (fresh.level, fresh.steps, fresh.curve) == (EqualityLevel.BIT_IDENTICAL, 200, ())
        number = answered["number"].found
        assert number is not None and number.first is not None and number.first_step is not None
        assert number.first_step < number.first.step == 150
        assert "ULP at step 150, the first recorded state" in evidence(answered["number"])
    assert found["mjx"]["number"].detail == "differs for 1, 2, 64 environments"
    assert found["newton"]["number"].detail == "differs for 1, 2 environments"


def test_what_results_depend_on_is_reported(evaluated: Evaluation) -> None:
    """Answer on the first screen, in a section, in the terminal, as JSON; list no run that only a probe needs."""
    made = report(Source(evaluated, published=False, command=""))
    (matrix,) = (table for table in made.tables() if table.key == "simulators")
    titles = [column.title for column in matrix.columns]
    for row in matrix.rows:
        assert row.cells[titles.index("same at any N")].text == "no"
        assert row.cells[titles.index("same in any slot")].text == "yes"
    assert any(isinstance(block, Section) and block.title == "What results depend on" for block in made.blocks)
    stream = io.StringIO()
    print_document(brief(evaluated), stream)
    shown = stream.getvalue()
    assert "newton 1.8.0, determinism run-to-run, solver=xpbd on NVIDIA H100" in shown
    assert "intervention=" not in shown
    assert "answers are yes (repeats itself from run to run, identical environments" in " ".join(shown.split())
    assert "of runs that only gsb-probe needs: --all" in shown
    assert [probe["simulator"] for probe in to_json(evaluated)["probes"]] == ["mjx", "newton"]


def test_a_run_that_answers_no_question_is_no_probe(tmp_path: Path) -> None:
    """Say nothing of gsb-probe of one run with drawn initial states, as laws in closed form are recorded."""
    path = _write(tmp_path, next(arm for arm in ARMS if arm.initial)).path
    found = evaluate_files([place(str(path))])
    assert found.probed == ()
    stream = io.StringIO()
    print_document(brief(found), stream)
    assert "gsb-probe" not in stream.getvalue()


def test_a_simulator_that_was_not_probed() -> None:
    """Leave a question open, and one that was not asked, apart from an answer."""
    assert depends([], "number").text == "not asked"


def test_levels_are_clocked_in_turn() -> None:
    """Clock every level equally often, forth and back, among as many environments as any arm has."""
    plans = [replace(PLAN, determinism=level) for level in ("default", "strict", "stricter")]
    order = [plan.determinism for plan in interleaved(plans)]
    assert order[:6] == ["default", "strict", "stricter", "stricter", "strict", "default"]
    assert Counter(order) == dict.fromkeys(("default", "strict", "stricter"), 4)
    arguments = PLAN.arguments(PLAN.priced, "out")
    assert arguments[arguments.index("--n-env") + 1] == "8"
    assert arguments[arguments.index("--phases") + 1] == "timed"
    clocked = RunConfiguration("synthetic", "inclined-collision", 8, 0.01, PLAN.steps, phases=("timed",))
    assert PLAN.has(clocked)
    assert arm_of(clocked) == PLAN.priced
    assert len(PLAN.missing([clocked])) == len(list(PLAN.arms()))


def test_what_a_level_costs(tmp_path: Path, gsb_probe: Command) -> None:
    """Print the throughput of a level relative to the default's with its interval, below its answers."""
    for level, seconds in (("default", 1.0), ("strict", 2.0)):
        for arm in (ARMS[0], ARMS[PLAIN_AGAIN]):
            _write(tmp_path, arm, determinism=level)
        for run in range(4):
            write_recording(
                tmp_path, None, n_env=8, steps=PLAN.steps, dt=0.01, elapsed_s=seconds + run / 100, determinism=level,
                switches={"sorted": level == "strict"},
            )  # fmt: skip
    done = gsb_probe(tmp_path, "--json", tmp_path / "answers.json", code=0)
    said = " ".join(done.stdout.split())
    assert "Throughput with 8 environments, relative to the default level: 0.50" in said
    assert said.count("Throughput with") == 1
    ((family,), probes) = (json.loads((tmp_path / "answers.json").read_text())[key] for key in ("prices", "probes"))
    (price,) = family["levels"]
    assert price["throughput_of_default"]["ratio"] == pytest.approx(0.5, rel=0.01)
    assert len(probes) == 2


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("gsb-probe", ["--sim", "mujoco"]),
        ("gsb-bisect", ["--sim", "mujoco", "--environment", "1.0=here", "--environment", "2.0=there"]),
    ],
)
def test_two_commands_in_one_folder(command: str, arguments: list[str], tmp_path: Path) -> None:
    """Refuse to record into a folder in which the same command is at work, and name the process; keep nothing of it."""
    with held_by(tmp_path, command, "is at work"):
        done = call(command, *arguments, "--out", tmp_path, code=1)
        assert f"process {os.getpid()} on" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_another_device(tmp_path: Path) -> None:
    """Compare the same arms of two devices, and blame no device where its runs differ anyway."""

    def of(folder: str, device: str, planted: dict[int, Planted] | None = None) -> list[Recording]:
        return [
            _write(tmp_path / folder, arm, (planted or {}).get(at), also=changing(SIMULATION, device=device))
            for at, arm in enumerate(ARMS)
            if at != PLAIN_AGAIN
        ]

    here = of("here", "cpu a")
    same = {one.arms.key.device: one for one in judged((*here, *of("same", "cpu b")))}
    assert len(same) == 2
    for one in same.values():
        found = {finding.key: finding for finding in one.findings}["device"]
        assert found.answer is Answer.YES
        assert f"{len(ARMS) - 2} runs and the same on cpu" in found.compared
    away = of("away", "cpu c", {1: _moved(2, 5, 7), USUAL_AGAIN: _moved(2, 5, 7), 3: _moved(1, 5, 4)})
    found = {f.key: f for f in judged((*here, *away))[0].findings}["device"]
    assert found.answer is Answer.NO
    assert found.found is not None
    assert found.found.first_step == 4
    assert found.detail == f"differs with 2 envs {ARMS[3].initial}, 4 envs {ARMS[1].initial}"
    noisy = of("noisy", "cpu d", {1: _moved(2, 5, 7)})
    assert "device" not in {finding.key for finding in judged((*here, *noisy))[0].findings}
