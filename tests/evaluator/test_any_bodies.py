"""Evaluation of recordings whose groups have any name: which bodies are the outcome, joints, units, every command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import compare, diff, evaluate, open_recording
from gpusimbench.evaluator.audit.audit import _sample_time
from gpusimbench.evaluator.check.rules.rule import PROTOCOL
from gpusimbench.evaluator.diff.words import amount, length
from gpusimbench.evaluator.metrics.joints import (
    JointSpace,
    distance_between_envs,
    distances_between_runs,
    joint_distance,
)
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.report.verdicts import alike, real, repeats
from gpusimbench.evaluator.results.details import JointsBetweenEnvs
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.runs.positions import outcome_of, sample_positions
from gpusimbench.evaluator.runs.spread import spread
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.recorder.scenes.registry import make_scene
from gpusimbench.schemas.errors import DamagedRecording, UsageError
from gpusimbench.schemas.fields import StateField, ball_fields, body_field, body_fields, joint_field
from tests.conftest import call
from tests.layouts import Layout, cart_pole, hostile, humanoid, pendulum, runs, states, write
from tests.synthetic import grid, write_recording

ROOT = Path(__file__).resolve().parents[2]


def _two_groups(outcome: Any = None) -> Layout:
    fields = body_fields({"chairs": ("a", "b"), "tables": ("t",)}, "float64")
    scene = {"name": "room", **({} if outcome is None else {"outcome": outcome})}
    return Layout("room", fields, described=json.dumps(scene))


def _groups(path: Path) -> tuple[str, ...] | Missing:
    found = outcome_of(open_recording(path))
    return found if isinstance(found, Missing) else tuple(field.group for field in found)


def test_all_free_bodies_are_the_outcome(tmp_path: Path) -> None:
    """Take every group with positions where nothing else is said, one behind the other."""
    layout = _two_groups()
    path = write(tmp_path, layout)
    assert _groups(path) == ("chairs", "tables")
    positions = sample_positions(open_recording(path), 0.2)
    assert not isinstance(positions, Missing)
    made = {f.name: array for f, array in zip(layout.fields, states(layout), strict=True)}
    expected = np.concatenate([made["chairs/position"][20], made["tables/position"][20]], axis=1)
    assert np.array_equal(positions.recorded, expected)


@pytest.mark.parametrize("outcome", [["tables"], ["chairs", "tables"], ["tables", "lamps"]])
def test_the_scene_declares_the_outcome(outcome: list[str], tmp_path: Path) -> None:
    """Take the groups that scene.json lists, of those that were recorded."""
    path = write(tmp_path, _two_groups(outcome))
    assert _groups(path) == tuple(g for g in ("chairs", "tables") if g in outcome)


def test_a_declared_group_that_is_not_there(tmp_path: Path) -> None:
    """Say which group was declared and not recorded; refuse a declaration that is no list of names."""
    path = write(tmp_path, _two_groups(["lamps"]))
    assert _groups(path) == Missing("no positions of lamps were recorded, which the scene declares as its outcome")
    (result,) = evaluate([path]).results
    assert "lamps" in str(result.metrics["w1_parallel"].value)
    bad = write(tmp_path, _two_groups({"lamps": 1}), run=1)
    with pytest.raises(DamagedRecording, match="outcome is not a list"):
        outcome_of(open_recording(bad))
    assert call("gsb-eval", bad).returncode == 3
    assert call("gsb-check", bad).returncode == 3


def test_bodies_that_begin_over_the_board(tmp_path: Path) -> None:
    """Take the cubes of inclined-collision by where they begin, whatever groups are called, and old files likewise."""
    old = ROOT / "recordings" / "mujoco-amd-r0.mcap"
    assert {f.group for f in open_recording(old).fields if f.field == "position"} == {"ball", "cubes"}
    assert _groups(old) == ("cubes",)
    text = make_scene("inclined-collision").to_json().replace('"cubes"', '"bricks"').replace('"ball"', '"marble"')
    groups = make_scene("inclined-collision").groups()
    fields = body_fields({"marble": groups["ball"], "bricks": groups["cubes"]}, "float32")
    assert _groups(write(tmp_path, Layout("mine", fields, described=text))) == ("bricks",)
    assert _groups(write_recording(tmp_path, grid(1), scene="free-fall")) == ("cubes",)


def test_groups_that_do_not_go_together(tmp_path: Path) -> None:
    """Say why positions of different number types are not compared together, and what would choose one."""
    fields = (body_field("a", "position", "float32", ("x",)), body_field("b", "position", "float64", ("y",)))
    path = write(tmp_path, Layout("mixed", fields))
    found = outcome_of(open_recording(path))
    assert '"outcome" in scene.json' in found.reason
    scene = {"name": "mixed", "outcome": ["b"]}
    assert _groups(write(tmp_path, Layout("mixed", fields, described=json.dumps(scene)), run=1)) == ("b",)


def _space(coordinates: Any, balls: Any = None) -> JointSpace:
    array = np.array(coordinates, dtype=np.float64)
    return JointSpace(array, np.zeros((len(array), 0, 4)) if balls is None else np.array(balls, dtype=np.float64))


def _about_x(angle: float) -> list[float]:
    return [np.cos(angle / 2), np.sin(angle / 2), 0.0, 0.0]


def test_joint_distance_against_the_formula() -> None:
    """Root mean square over joints; of ball joints the angle of rotation, of q and -q the same."""
    one = _space([[0.0, 1.0], [0.0, 0.0]])
    other = _space([[3.0, 5.0], [0.0, 0.0]])
    assert np.allclose(joint_distance(one, other), [np.sqrt((9 + 16) / 2), 0.0])
    turned = _space([[0.0]], [[_about_x(0.3), _about_x(2.0)]])
    still = _space([[0.4]], [[_about_x(0.0), (-np.array(_about_x(2.0))).tolist()]])
    assert np.allclose(joint_distance(turned, still), np.sqrt((0.4**2 + 0.3**2 + 0.0) / 3))
    tiny = _space([[0.0]], [[_about_x(0.0)]]), _space([[0.0]], [[_about_x(1e-9)]])
    assert joint_distance(*tiny)[0] == pytest.approx(1e-9 / np.sqrt(2), rel=1e-6)
    with pytest.raises(ValueError, match="the same"):
        joint_distance(one, _space([[0.0]]))


def test_mean_over_pairs_against_all_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Match a loop over all pairs of environments, in chunks of any size, and a matrix over runs."""
    draw = np.random.default_rng(0)
    quaternions = draw.standard_normal((7, 2, 4))
    space = _space(draw.standard_normal((7, 3)), quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True))
    pairs = [
        joint_distance(space.of(np.array([i])), space.of(np.array([j])))[0] for i in range(7) for j in range(i + 1, 7)
    ]
    assert distance_between_envs(space).mean == pytest.approx(np.mean(pairs))
    monkeypatch.setattr("gpusimbench.evaluator.metrics.joints._CHUNK_PAIRS", 1)
    assert distance_between_envs(space).mean == pytest.approx(np.mean(pairs))
    monkeypatch.setattr("gpusimbench.evaluator.metrics.joints.MAX_ENVS", 5)
    assert distance_between_envs(space).drawn == 5
    matrix = distances_between_runs([space, space, space.of(slice(None, None, -1))])
    assert matrix[0, 1] == 0.0
    assert matrix[0, 2] == matrix[2, 0] == joint_distance(space, space.of(slice(None, None, -1))).mean() > 0


def _metrics(files: Any) -> dict[str, Any]:
    (result,) = evaluate(files).results
    return dict(result.metrics)


def test_a_humanoid_has_both(tmp_path: Path) -> None:
    """Compare the floating base by W1 and the joints by angles and travel, each as computed by hand from the states."""
    layout = humanoid(n_env=3)
    metrics = _metrics(runs(tmp_path, layout, 2))
    assert not isinstance(metrics["w1_run_to_run"].value, Missing)
    made = [dict(zip([f.name for f in layout.fields], states(layout, run), strict=True)) for run in range(2)]
    qpos = [one["joints/qpos"][20, :, :, 0].astype(np.float64) for one in made]
    balls = [one["balls/orientation"][20].astype(np.float64) for one in made]
    angles = np.minimum(
        2 * np.arccos(np.clip(np.abs((balls[0] * balls[1]).sum(-1)), 0, 1)), np.pi
    )  # of rotations that are far enough apart for arccos
    squares = ((qpos[0] - qpos[1])[:, :26] ** 2).sum(1) + (angles**2).sum(1)
    assert metrics["joint_angle_run_to_run"].value == pytest.approx(np.sqrt(squares / 28).mean(), rel=2e-2)
    slide = np.abs((qpos[0] - qpos[1])[:, 26]).mean() * 100
    assert metrics["joint_slide_run_to_run"].value == pytest.approx(slide)
    assert (metrics["joint_angle_parallel"].unit, metrics["joint_slide_parallel"].unit) == ("rad", "cm")
    assert metrics["joint_angle_run_to_run"].details.joints == 28


def test_the_first_screen_has_the_distance_of_runs_and_that_of_environments(tmp_path: Path) -> None:
    """Say how far apart the joints of runs are, and those of environments, each where it is asked."""
    (result,) = evaluate(runs(tmp_path, pendulum(), 2)).results
    between_runs, between_envs = (
        f"no, {result.metrics[f'joint_angle_{what}'].value:.3g} rad" for what in ("run_to_run", "parallel")
    )
    assert between_runs != between_envs
    assert (repeats([result]).text, alike([result]).text) == (between_runs, between_envs)


def test_what_does_not_apply_says_what_it_needs(tmp_path: Path) -> None:
    """Give a reason that names what is missing: bodies, a board, a floor, joints that slide, limits."""
    metrics = _metrics(runs(tmp_path, pendulum()))
    needs = {
        "w1_parallel": 'needs a group with the field "position"',
        "w1_run_to_run": 'needs a group with the field "position"',
        "left_board": "scene.json names no board",
        "joint_slide_parallel": "no joint slides: those that were recorded are in rad",
    }
    for name, words in needs.items():
        assert words in metrics[name].value.reason
    assert metrics["joint_angle_parallel"].value > 0
    (result,) = evaluate(list(tmp_path.glob("*.mcap"))).results
    printed = call("gsb-eval", tmp_path, "--all").stdout
    assert "scene.json does not describe every joint with its limits" in printed
    assert result.metrics["sank"].value == Missing(metrics["w1_parallel"].value.reason)


def test_equal_runs_are_at_distance_zero(tmp_path: Path) -> None:
    """Say yes, and zero, where all runs and environments are alike."""
    metrics = _metrics(runs(tmp_path, replace(humanoid(4), noise=0.0)))
    for name in ("joint_angle_parallel", "joint_angle_run_to_run", "joint_slide_parallel", "joint_slide_run_to_run"):
        assert metrics[name].value == 0.0


def test_joints_that_are_not_finite(tmp_path: Path) -> None:
    """Give no distance of joints that are not finite, and none of units that are unknown."""
    names = ("a", "b")
    odd = StateField("joints", "qpos", "float64", names, ("coordinate",), "deg", "joint")
    metrics = _metrics(runs(tmp_path, Layout("odd", (odd,))))
    assert "no joint turns: those that were recorded are in deg" in str(metrics["joint_angle_parallel"].value)
    assert "no joint slides: those that were recorded are in deg" in str(metrics["joint_slide_parallel"].value)


def test_sample_time_of_a_scene(tmp_path: Path) -> None:
    """Take the time that the scene names; the last common one where it names none, or none has it; say which."""
    fields = body_fields({"things": ("a",)}, "float64")

    def recorded(folder: str, steps: int, named: float | None) -> list[Path]:
        scene = {"name": folder, **({} if named is None else {"sample_time": named})}
        (tmp_path / folder).mkdir()
        return list(runs(tmp_path / folder, Layout(folder, fields, steps=steps, described=json.dumps(scene)), 2))

    for files, time, said in (
        (recorded("named", 60, 0.25), 0.25, "the sample time of the scene"),
        (recorded("short", 20, 0.25), 0.2, "the last time that all its recordings have; none has 5 s"),
        (recorded("silent", 600, None), 6.0, "all its recordings have; scene.json names no sample time"),
    ):
        evaluation = evaluate(files)
        (result,) = evaluation.results
        assert evaluation.sampled_at(result.group.key.scene) == time
        assert result.group.recordings[0].positions.time == pytest.approx(time)
        recording = open_recording(files[0])
        outcome = outcome_of(recording)
        assert isinstance(outcome, tuple)
        assert _sample_time(recording, outcome) == pytest.approx(time)  # that of an audit
        assert any(said in note for note in evaluation.notes), evaluation.notes


def test_compare_joints(tmp_path: Path) -> None:
    """Call a change of where joints end by its name and unit, and equal joints the same."""
    layout = replace(cart_pole(), noise=1e-6)
    base = [write(tmp_path, layout, run, simulator="mine") for run in range(4)]
    (tmp_path / "head").mkdir()
    moved = [write(tmp_path / "head", replace(layout, noise=0.3), run + 10) for run in range(4)]
    found = {finding.name: finding for finding in compare(base, moved).findings}
    assert found["outcome_joint_angles"].unit == "rad"
    assert found["outcome_joint_slides"].unit == "cm"
    for name in ("outcome_joint_angles", "outcome_joint_slides"):
        assert found[name].p_value == pytest.approx(2 / 70)
    assert found["joint_angle_run_to_run"].head > found["joint_angle_run_to_run"].base
    done = call("gsb-compare", "--base", *base, "--head", *moved, "--all", "--no-cache")
    assert done.returncode in (4, 5)
    assert "undecided: where joints end, angles, where sliding joints end: too few runs" in done.stdout


def test_diff_keeps_units_apart(tmp_path: Path) -> None:
    """Give metres and radians of one field in parts of their own, and equal files as bit-identical by all hashes."""
    one, other = (write(tmp_path, cart_pole(), run) for run in range(2))
    found = {field.field: field for field in diff(one, other).compared.fields}
    assert {name: field.unit for name, field in found.items()} == {
        "joints/qpos [m]": "m", "joints/qpos [rad]": "rad", "joints/qvel [m/s]": "m/s", "joints/qvel [rad/s]": "rad/s",
    }  # fmt: skip
    made = [states(cart_pole(), run)[0][..., 0] for run in range(2)]
    for item, name in enumerate(("joints/qpos [m]", "joints/qpos [rad]")):
        assert found[name].max_distance == pytest.approx(np.abs(made[0] - made[1])[..., item].max())
    assert " m or rad" not in call("gsb-diff", one, other, "--all").stdout
    slid, turned = (found[f"joints/qpos [{unit}]"].max_distance for unit in ("m", "rad"))
    apart = f"joints        up to {length(slid)} (joints/qpos) and {amount(turned, 'rad')} (joints/qpos) apart"
    assert apart in call("gsb-diff", one, other).stdout
    alike = write(tmp_path, cart_pole(), 0, simulator="twin")
    same = diff(one, alike)
    assert same.bit_identical
    assert same.compared.hash_steps is not None


def test_diff_of_other_units(tmp_path: Path) -> None:
    """Leave out the items that one side has in another unit."""
    sides = []
    for number, slides in enumerate((("slider",), ("slider", "hinge"))):
        field = joint_field("joints", "qpos", "float64", ("slider", "hinge"), slides=slides)
        sides.append(write(tmp_path, Layout("cart-pole", (replace(field, components=("coordinate",)),)), number))
    found = diff(*sides)
    (field,) = found.compared.fields
    assert (field.unit, field.numbers) == ("m", 4 * 21)
    assert any("1 items in common, of 2 in a, 2 in b" in line for line in found.compared.left_out)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (body_fields({"<img>": ("a",)}, "float32"), "small letters, digits and _"),
        (body_fields({"view": ("a",)}, "float32"), "no group is named view"),
        (body_fields({"a/b": ("a",)}, "float32"), "small letters"),
        (body_fields({"a": ()}, "float32"), "has no items"),
        ((replace(joint_field("j", "qpos", "float32", ("a", "b")), item_units=("m",)),), "has 1 units, and 2 items"),
    ],
)
def test_what_could_not_be_read_is_not_written(fields: tuple[StateField, ...], message: str, tmp_path: Path) -> None:
    """Refuse names of groups that no reader would take for states, before a file is made."""
    with pytest.raises(UsageError, match=message):
        RecordingWriter(
            tmp_path / "a.mcap", simulator="m", version="1", scene="s", n_env=1, dt=0.1, steps=1, fields=fields
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("layout", [humanoid(8), pendulum(), cart_pole(), hostile()], ids=lambda one: one.scene[:8])
def test_every_command(layout: Layout, tmp_path: Path) -> None:
    """Run every command that reads recordings: documented exit codes, nothing of a hostile name in force."""
    files = runs(tmp_path, layout)
    a, b, c = files
    moves = any(field.field == "position" for field in layout.fields)
    for command, codes in (
        (("gsb-info", a, "--all"), (0,)),
        (("gsb-check", *files), (0,)),
        (("gsb-eval", *files, "--all", "--html", tmp_path / "report", "--json", tmp_path / "eval.json"), (0,)),
        (("gsb-diff", a, b, "--all"), (4,)),
        (("gsb-diff", a), (4,)),
        (("gsb-compare", "--base", a, "--head", b, c), (5,)),
        (("gsb-view", a, "--no-open", "--out", tmp_path / "view.html"), (0,) if moves else (5,)),
    ):
        done = call(*command)
        assert done.returncode in codes, (command, done.stdout, done.stderr)
        assert "Traceback" not in done.stderr
        assert "\x1b" not in done.stdout + done.stderr
        assert "\x00" not in done.stdout
    page = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert "<script>alert" not in page
    assert "<b>scene" not in page
    json.loads((tmp_path / "eval.json").read_text(encoding="utf-8"))


def test_why_joints_alone_are_not_drawn(tmp_path: Path) -> None:
    """Say that joints were recorded and what is missing, not that there are no states."""
    done = call("gsb-view", write(tmp_path, pendulum()), "--no-open", "--out", tmp_path / "view.html")
    assert "holds states of joints, of which no place follows" in done.stderr
    body = write(tmp_path, humanoid(2), 1)
    shown = call("gsb-view", body, "--no-open", "--out", tmp_path / "view.html")
    assert "1 body has no known shape and is shown as a dot" in shown.stderr
    assert "Not shown: joints, balls" in shown.stderr


def test_joints_come_apart(tmp_path: Path) -> None:
    """Follow hinges [rad], or slides [m] without a hinge, against the formulas over all pairs of environments."""
    for layout, unit in (
        (cart_pole(), "rad"),
        (Layout("rail", (joint_field("joints", "qpos", "float64", ("a", "b"), slides=("a", "b")),)), "m"),
    ):
        path = write(tmp_path, layout, simulator=layout.scene)
        found = spread(open_recording(path))
        assert not isinstance(found, Missing)
        values = states(layout)[0][..., 0][:, :, [1] if unit == "rad" else [0, 1]]
        apart = values[:, :, None] - values[:, None]
        pairs = np.triu_indices(layout.n_env, k=1)
        rms = np.sqrt((apart[:, pairs[0], pairs[1]] ** 2).mean(axis=(1, 2)))
        assert (found.unit, found.bodies, found.groups) == (unit, False, ("joints",))
        assert np.allclose(np.array(found.rms, dtype=np.float64), rms, rtol=1e-9, atol=0)
        assert np.allclose(np.array(found.largest, dtype=np.float64), np.abs(apart[:, :, 0]).max(axis=(1, 2)), atol=0)
        call("gsb-eval", path, "--html", tmp_path / f"of-{layout.scene}", "--no-cache", code=0)
        told = (tmp_path / f"of-{layout.scene}" / "index.html").read_text(encoding="utf-8")
        assert f"envs 1 m{unit} apart by [s]" in told
        assert "the largest distance of a joint from where it is in environment 0" in told
    body = spread(open_recording(write(tmp_path, humanoid(3), simulator="humanoid")))
    assert not isinstance(body, Missing)
    assert (body.unit, body.bodies, body.groups) == ("m", True, ("bodies",))


def test_the_protocol_is_for_the_benchmark(tmp_path: Path) -> None:
    """Count no rule of the benchmark for a program's own scene; beside the benchmark's scenes, say which are asked."""
    own = write(tmp_path, pendulum())
    evaluation = evaluate([own])
    assert evaluation.unmet.count == 0
    note = (
        f"{PROTOCOL} is for the benchmark's own scenes; of pendulum, only its rules on timed steps and evidence of "
        "work are asked, and only to rank throughputs"
    )
    assert note not in evaluation.notes
    printed = call("gsb-eval", own, "--all").stdout
    assert "Every file was read, and every run is complete." in printed
    beside = evaluate([own, ROOT / "recordings" / "mujoco-amd-r0.mcap"])
    assert note in beside.notes
    assert beside.unmet.count == evaluate([ROOT / "recordings" / "mujoco-amd-r0.mcap"]).unmet.count > 0


def test_reference_without_bodies(tmp_path: Path) -> None:
    """Take a recording of joints alone as a reference for joints, and one of neither joints nor bodies as none."""
    files = runs(tmp_path, pendulum(), 3)
    evaluation = evaluate(files[:2], reference=files[2])
    (result,) = evaluation.results
    ends = [states(pendulum(), run)[0][20, :, :, 0] for run in range(3)]
    far = [np.abs(end - ends[2]).mean() for end in ends[:2]]
    found = result.metrics["joint_angle_real"]
    assert found.value == pytest.approx(np.mean(far)) and min(far) > 0
    assert found.of(JointsBetweenEnvs).per_run == pytest.approx(far)
    assert result.metrics["joint_slide_real"].value == Missing("no joint slides: those that were recorded are in rad")
    assert "needs a group" in str(result.metrics["w1_real"].value)
    assert real([result]).text == f"{found.value:.3g} rad"
    said = call("gsb-eval", *files[:2], "--reference", files[2], code=0).stdout
    assert f"distance to the reference {found.value:.3g} rad" in " ".join(said.split())
    assert "distance: in joint space, to mine with" in said
    rate = StateField("joints", "qvel", "float64", ("a",), ("rate",), "rad/s", "joint")
    speeds = write(tmp_path, Layout("pendulum", (rate,)), 9, simulator="b")
    assert "cannot be used: no positions" in evaluate(files[:2], reference=speeds).reference_note


def test_joints_to_a_reference_are_matched_by_name(tmp_path: Path) -> None:
    """Compare each joint with the one of its name in any order; give no distance of other joints or envs."""
    names = ("a", "b", "c")
    draw = np.random.default_rng(1)
    angles, balls = draw.standard_normal((2, 4, 3, 1)), draw.standard_normal((2, 4, 2, 4))
    balls /= np.linalg.norm(balls, axis=-1, keepdims=True)

    def made(name: str, order: list[int], envs: int = 4, names: tuple[str, ...] = names, shift: float = 0.0) -> Path:
        fields = (
            joint_field("joints", "qpos", "float64", tuple(names[k] for k in order)),
            ball_fields("balls", "float64", ("left", "right") if order[0] == 0 else ("right", "left"))[0],
        )
        turned = balls if order[0] == 0 else balls[:, :, ::-1]
        with RecordingWriter(
            tmp_path / f"{name}.mcap", simulator=name, version="1", scene="arm", n_env=envs, dt=0.1, steps=1,
            fields=fields,
        ) as log:  # fmt: skip
            log.append(angles[:, :envs][:, :, order] + shift, turned[:, :envs])
        return tmp_path / f"{name}.mcap"

    def distance(reference: Path) -> Any:
        (result,) = evaluate([one], reference=reference).results
        return result.metrics["joint_angle_real"].value

    one = made("one", [0, 1, 2])
    assert distance(made("same", [2, 1, 0])) == 0.0
    assert distance(made("moved", [2, 0, 1], shift=0.5)) == pytest.approx(np.sqrt(3 * 0.25 / 5))
    assert distance(made("fewer", [0, 1, 2], envs=3)) == Missing("the reference has 3 envs, this group 4")
    assert distance(made("other", [0, 1, 2], names=("a", "b", "d"))) == Missing("the reference has other joints")
    assert distance(made("less", [0, 1])) == Missing("the reference has other joints")


def test_a_ball_joint_that_is_no_rotation(tmp_path: Path) -> None:
    """Give no angle between numbers that are no unit quaternions."""
    layout = Layout("balls", ball_fields("balls", "float64", ("hip",)), n_env=2, steps=2)
    path = tmp_path / "a.mcap"
    with RecordingWriter(
        path, simulator="m", version="1", scene="balls", n_env=2, dt=0.1, steps=2, fields=layout.fields
    ) as log:
        log.append(np.zeros((3, 2, 1, 4)), np.zeros((3, 2, 1, 3)))
    (result,) = evaluate_files([path], sample_time=0.2).results
    assert "no unit quaternions" in str(result.metrics["joint_angle_parallel"].value)
