"""Errors of simulated tosses against measured ones."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from gpusimbench.evaluator.check.rules.findings import Unmet
from gpusimbench.evaluator.metrics.tosses import (
    Cube,
    Motion,
    angle,
    depths,
    rest_times,
    toss_errors,
    tracking_floor,
    up,
)
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.brief import brief
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.report.leaders import fastest
from gpusimbench.evaluator.report.sections.scatter import pictures
from gpusimbench.evaluator.report.sections.tosses import section
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import TOSS_METRICS, TOSS_POSITION, beaten_by, ranked
from gpusimbench.evaluator.runs.toss_motion import errors_of, measured_tosses
from gpusimbench.evaluator.statistics.cases import mean_interval, paired
from gpusimbench.recorder.trials.tosses import Tosses, read_tosses
from tests.conftest import Command, recorded

CUBE = Cube(edge=0.1, mass=0.4, inertia=0.4 * 0.01 / 6, gravity=9.81)
DT = 0.01


def _quaternion(rotation: Rotation) -> np.ndarray:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def flight(rows: int = 20, tosses: int = 3, height: float = 5.0, seed: int = 0) -> Motion:
    """Cubes that fall freely and turn at a constant rate, by the formulas."""
    rng = np.random.default_rng(seed)
    time = np.arange(rows)[:, None, None] * DT
    place, speed, rate = rng.normal(size=(3, tosses, 3))
    place[:, 2] += height
    position = place + speed * time - np.array([0, 0, 9.81]) * time**2 / 2
    begin = Rotation.random(tosses, random_state=seed)
    orientation = np.stack([_quaternion(Rotation.from_rotvec(rate * k * DT) * begin) for k in range(rows)])
    velocity = speed - np.array([0, 0, 9.81]) * time
    return Motion(np.arange(rows), position, orientation, velocity, np.broadcast_to(rate, position.shape).copy())


def test_energy_is_of_height_speed_and_spin() -> None:
    """Give m g h, m v^2 / 2 and I w^2 / 2 of what a simulation has more of than the measured tosses, each by itself."""
    rows, zero = np.arange(3), np.zeros((3, 1, 3))
    facing = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (3, 1, 4))
    measured = Motion(rows, zero, facing, zero, zero)
    up_by, speed, spin = zero + [0.0, 0.0, 0.2], zero + [3.0, 0.0, 4.0], zero + [0.0, 7.0, 0.0]
    for more, expected in (
        (Motion(rows, up_by, facing, zero, zero), 0.4 * 9.81 * 0.2),
        (Motion(rows, zero, facing, speed, zero), 0.4 * 25.0 / 2.0),
        (Motion(rows, zero, facing, zero, spin), 0.4 * 0.01 / 6.0 * 49.0 / 2.0),
        (Motion(rows, zero, facing, speed, spin), 0.4 * 25.0 / 2.0 + 0.4 * 0.01 / 6.0 * 49.0 / 2.0),
    ):
        assert toss_errors(more, measured, np.array([3]), CUBE, DT).energy == pytest.approx([expected])


@given(st.tuples(*[st.floats(-1, 1)] * 3), st.floats(0, math.pi), st.integers(0, 9))
def test_angle(axis: tuple[float, ...], turn: float, seed: int) -> None:
    """Give back the angle of a rotation, whichever of its two quaternions is taken."""
    unit = np.array(axis) + [0, 0, 2.0]
    unit /= np.linalg.norm(unit)
    first = Rotation.random(random_state=seed)
    second = Rotation.from_rotvec(turn * unit) * first
    a, b = _quaternion(first), _quaternion(second)
    assert float(angle(a, b)) == pytest.approx(turn, abs=1e-7)
    assert float(angle(a, -b)) == pytest.approx(turn, abs=1e-7)


def test_no_error() -> None:
    """Find nothing between equal motions, and the same face up."""
    motion = flight()
    errors = toss_errors(motion, motion, np.array([20, 12, 7]), CUBE, DT)
    for name in ("position", "rotation", "end_position", "end_rotation", "rest_time", "energy"):
        assert not getattr(errors, name).any(), name
    assert errors.end_face.tolist() == [1.0, 1.0, 1.0]


def test_known_errors() -> None:
    """Measure a shift that grows with time, over the rows of each toss alone, without the first."""
    motion = flight()
    shift = np.zeros_like(motion.position)
    shift[..., 0] = np.arange(20)[:, None] * 0.001
    shift[12:, 1] = 99.0  # after the end of the second toss
    turned = (
        Rotation.from_rotvec([0, 0, 0.2]) * Rotation.from_quat(np.roll(motion.orientation, -1, axis=-1).reshape(-1, 4))
    ).as_quat()
    moved = Motion(
        motion.rows, motion.position + shift, np.roll(turned, 1, axis=-1).reshape(motion.orientation.shape),
        motion.linear_velocity, motion.angular_velocity,
    )  # fmt: skip
    errors = toss_errors(moved, motion, np.array([20, 12, 7]), CUBE, DT)
    np.testing.assert_allclose(errors.position, [0.001 * np.mean(range(1, n)) for n in (20, 12, 7)])
    np.testing.assert_allclose(errors.end_position, [0.019, 0.011, 0.006])
    np.testing.assert_allclose(errors.rotation, 0.2)
    np.testing.assert_allclose(errors.end_rotation, 0.2)
    assert not errors.energy.any()


def test_fewer_rows() -> None:
    """Compare at the rows that a simulation has; the last of them within a toss is its end."""
    motion = flight()
    rows = np.arange(0, 20, 4)
    found = Motion(rows, *(getattr(motion, name)[rows] for name in
                           ("position", "orientation", "linear_velocity", "angular_velocity")))  # fmt: skip
    found.position[3:, 1] += [0.0, 0.03, 0.04]  # row 12 on: beyond the second toss
    errors = toss_errors(found, motion, np.array([20, 12, 20]), CUBE, DT)
    assert errors.end_position.tolist() == [0.0, 0.0, 0.0]
    found.position[2, 1] += [0.0, 0.03, 0.04]
    assert toss_errors(found, motion, np.array([20, 12, 20]), CUBE, DT).end_position[1] == pytest.approx(0.05)


def test_up() -> None:
    """Name the face whose outward normal points up."""
    turned = [
        Rotation.identity(),
        Rotation.from_euler("x", 180, degrees=True),
        Rotation.from_euler("y", -90, degrees=True),
    ]
    assert up(np.stack([_quaternion(one) for one in turned])).tolist() == [2, 5, 0]


def test_depth() -> None:
    """Measure the lowest corner of a tilted cube."""
    tilted = _quaternion(Rotation.from_euler("x", 45, degrees=True))
    motion = Motion(
        np.arange(1), np.array([[[0, 0, 0.06]]]), tilted[None, None], np.zeros((1, 1, 3)), np.zeros((1, 1, 3))
    )
    assert float(depths(motion, 0.1)[0, 0]) == pytest.approx(0.05 * math.sqrt(2) - 0.06)


def test_rest() -> None:
    """Date the rest from the last motion: the last row of a cube that never rests, the first of an idle cube."""
    motion = flight(rows=10)
    motion.linear_velocity[:], motion.angular_velocity[:] = 0.0, 0.0
    motion.linear_velocity[:4, 0] = 0.05
    motion.angular_velocity[:7, 1] = 0.5
    motion.linear_velocity[:, 2] = 1.0
    within = np.ones((10, 3), dtype=bool)
    np.testing.assert_allclose(rest_times(motion, within, DT), [0.04, 0.07, 0.09])
    motion.linear_velocity[:] = motion.angular_velocity[:] = 0.0
    np.testing.assert_allclose(rest_times(motion, within, DT), 0.0)


def test_floor() -> None:
    """Find no floor in an exact free fall, and in a noisy one the noise."""
    motion = flight()
    counts = np.array([20, 20, 20])
    exact = tracking_floor(motion, counts, CUBE, DT, motion.linear_velocity[0])
    assert exact.position == pytest.approx(0.0, abs=1e-12)
    assert exact.rotation == pytest.approx(0.0, abs=1e-7)
    assert (exact.tosses, exact.rows) == (3, 19.0)
    short = tracking_floor(motion, np.array([10, 20, 1]), CUBE, DT, motion.linear_velocity[0])
    assert (short.tosses, short.rows) == (2, (9 + 19) / 2)  # later rows repeat the last, and the first is given
    motion.position[1:] += [0.0, 0.003, 0.004]
    assert tracking_floor(motion, counts, CUBE, DT, motion.linear_velocity[0]).position == pytest.approx(0.005)
    low = Motion(motion.rows, motion.position - [0, 0, 20.0], *list(vars(motion).values())[2:])
    assert tracking_floor(low, counts, CUBE, DT, motion.linear_velocity[0]).tosses == 0


def _run(*arguments: str) -> Path:
    (path,) = recorded("--scene", "cube-toss", "--runs", "1", "--phases", "capture", "--no-view", *arguments)
    return path


@pytest.fixture(scope="module")
def reference() -> Path:
    """The synthetic tosses."""
    (path,) = recorded("--sim", "real", "--scene", "cube-toss")
    return path


@pytest.fixture(scope="module")
def runs() -> dict[str, Path]:
    """The same tosses simulated: as it ships, with a cone that the truth does not have, and coarsely recorded."""
    return {
        "elliptic": _run("--sim", "mujoco"),
        "pyramidal": _run("--sim", "mujoco", "--option", "cone=pyramidal"),
        "substeps": _run("--sim", "mujoco", "--dt", str(1 / 148 / 4), "--stride", "4"),
    }


@pytest.mark.parametrize("field", ["position", "orientation", "linear_velocity", "angular_velocity"])
def test_a_toss_that_blew_up_has_no_errors(
    reference: Path, runs: dict[str, Path], monkeypatch: pytest.MonkeyPatch, field: str
) -> None:
    """Give the reason where any part of a state is not finite."""
    measured = measured_tosses(Recording(reference))
    assert measured is not None
    read = StateArray.read

    def spoiled(self: StateArray, *at: Any) -> Any:
        found = np.array(read(self, *at), dtype=np.float64)
        if self.field.field == field:
            found[1:] = np.nan
        return found

    monkeypatch.setattr(StateArray, "read", spoiled)
    assert errors_of(Recording(runs["elliptic"]), measured) == Missing("its states are not all finite")


@pytest.mark.parametrize(("dt", "whole"), [(1 / 148, True), (1 / 296, True), (1 / 100, False), (1 / 333, False)])
def test_a_step_that_misses_the_measured_rows_has_no_errors(
    reference: Path, dt: float, whole: bool, tmp_path: Path
) -> None:
    """Compare states at the times of measured rows alone, 1/148 s apart, and at no others near them."""
    measured = measured_tosses(Recording(reference))
    assert measured is not None
    simulated = errors_of(Recording(_run("--sim", "mujoco", "--dt", str(dt), "--steps", "20")), measured)
    assert ("no whole part of" in str(simulated)) is not whole


def test_a_wrong_cone_is_seen(reference: Path, runs: dict[str, Path]) -> None:
    """Rank the cone of the truth before another, certainly, at either step."""
    found = evaluate_files([reference, *runs.values()])
    order = ranked(found.results)
    names = {str(path): name for name, path in runs.items()}
    assert {names[str(one.result.group.recordings[0].path)] for one in order[:2]} == {"substeps", "elliptic"}
    last = order[-1]
    assert last.against.cases == 48
    assert last.against.ci95[0] > 0.5
    assert last.adjusted < 0.001
    floor = found.reference.tosses.floor
    assert 0 < floor.position < 0.002
    for metric in TOSS_METRICS:
        value = order[0].result.metrics[metric.name]
        assert not isinstance(value.value, Missing)
        assert value.ci95[0] <= value.value <= value.ci95[1]


def test_fastest_at_equal_accuracy() -> None:
    """Name the fastest whose error the tosses do not tell from the smallest, and beside it who is faster and errs more.

    The recordings are those that ship, which were not timed: throughputs are given to them here.
    """
    folder = Path(__file__).resolve().parents[2] / "recordings" / "cube-toss"
    names = ("real", "mujoco", "warp", "sapien", "mjx")
    found = evaluate_files([path for name in names for path in sorted(folder.glob(f"{name}-*.mcap"))])
    speeds = {"mujoco": 1e5, "warp": 2e5, "sapien": 3e5, "mjx": 4e5}
    timed = [
        replace(r, metrics={**r.metrics, FPS.name: replace(r.metrics[FPS.name], value=speeds[r.group.key.simulator])})
        for r in found.results
    ]
    (one,) = fastest(timed)
    assert (one.first.result.group.key.simulator, one.second.result.group.key.simulator) == ("warp", "mujoco")
    why = {speed.result.group.key.simulator: reason for speed, reason in one.faster}
    assert why.keys() == {"sapien", "mjx"}
    assert all(reason.startswith("less accurate: error of position ") for reason in why.values())
    assert beaten_by(ranked(timed))[one.first.result.label] == ""
    evaluation = replace(found, results=tuple(timed))
    text = render_html(evaluation, published=False, command="")
    assert f"Fastest at equal accuracy: {one.first.result.label}, 200,000 env-steps/s" in text
    assert "is faster and not measurably less accurate" in text
    drawn = next(p for p in pictures(evaluation) if "cube-toss" in p.caption or "cube-toss" in str(p))
    assert TOSS_POSITION.titled in str(drawn)


def test_the_first_screen_says_what_distances_are_to() -> None:
    """Name the tosses that are compared with on the first screen and in the section: nobody measured these."""
    folder = Path(__file__).resolve().parents[2] / "recordings" / "cube-toss"
    found = evaluate_files([*folder.glob("real-*.mcap"), *sorted(folder.glob("sapien-*.mcap"))])
    said = "48 tosses: synthetic tosses, made by a simulation"
    screen = io.StringIO()
    print_document(brief(found), screen)
    assert f"distance: mean error of position against {said}" in screen.getvalue()
    assert "no distance to reality" not in screen.getvalue()
    tosses = section(Source(found, False, ""))
    assert tosses.summary.startswith(f"{said}; 1 group; ")
    assert tosses.title == "Accuracy: synthetic tosses"
    reference = found.reference
    known = replace(reference.tosses.known, source="measured tosses")
    measured = replace(found, reference=replace(reference, tosses=replace(reference.tosses, known=known)))
    tosses = section(Source(measured, False, ""))
    assert tosses.title == "Accuracy: measured tosses"


def test_a_throughput_belongs_to_the_errors_of_its_configuration() -> None:
    """Put the throughput of many environments beside the errors that few have; name none as fastest without errors."""
    folder = Path(__file__).resolve().parents[2] / "recordings" / "cube-toss"
    names = ("real", "mujoco", "warp", "sapien", "mjx")
    found = evaluate_files([path for name in names for path in sorted(folder.glob(f"{name}-*.mcap"))])
    none = Missing("the capture phase was left out")

    def timed(result: GroupResult, n_env: int, speed: float, **changed: Any) -> GroupResult:
        key = replace(result.group.key.with_settings(initial="states:00"), n_env=n_env, **changed)
        metrics = {name: replace(estimate, value=none) for name, estimate in result.metrics.items()}
        metrics[FPS.name] = replace(metrics[FPS.name], value=speed)
        group = replace(result.group, key=key)
        return replace(result, label=f"{result.label} x {n_env} {changed}", group=group, metrics=metrics)

    speeds = {"mujoco": 1e5, "warp": 2e5, "sapien": 3e5, "mjx": 4e5}
    clocked = [timed(r, n, n * speeds[r.group.key.simulator]) for n in (64, 4096) for r in found.results]
    (warp,) = [r for r in found.results if r.group.key.simulator == "warp"]
    clocked.append(timed(warp, 4096, 1e12, options='{"cone": "none"}'))
    results = [*found.results, *clocked]
    order = ranked(results)
    assert {(one.timed.group.key.n_env if one.timed else 0, one.fps) for one in order} == {
        (4096, 4096 * speed) for speed in speeds.values()
    }
    assert all(
        one.with_throughput.metrics[TOSS_POSITION.name] == one.result.metrics[TOSS_POSITION.name] for one in order
    )
    (one,) = fastest(results)
    assert (one.first.result.group.key.simulator, one.first.fps) == ("warp", 4096 * 2e5)
    why = {speed.result.label: reason for speed, reason in one.faster}
    unknown = "no run of this configuration has errors against tosses"
    assert [reason for label, reason in why.items() if "none" in label] == [unknown]
    assert sum(reason.startswith("less accurate") for reason in why.values()) == 2
    unmet = replace(warp.timed, unmet=Unmet({"timed-seconds": 1}))  # of the run that has errors, not of the timed one
    (one,) = fastest([replace(r, timed=unmet) if r is warp else r for r in results])
    assert one.first is not None and one.first.result.group.key.simulator != "warp"
    reasons = [reason for speed, reason in one.faster if speed.result.group.key.options == warp.group.key.options]
    assert reasons == [unmet.unmet.of_throughput]


def test_order_does_not_matter(reference: Path, runs: dict[str, Path], tmp_path: Path, gsb_record: Command) -> None:
    """Find the toss of each environment by its first state: another order, fewer or more of them give the same."""
    measured = measured_tosses(Recording(reference))
    assert measured is not None
    whole = errors_of(Recording(runs["elliptic"]), measured)
    assert not isinstance(whole, Missing)
    assert len(whole.position) == 48
    for n_env in (5, 50):
        part = errors_of(Recording(_run("--sim", "mujoco", "--n-env", str(n_env))), measured)
        assert not isinstance(part, Missing)
        np.testing.assert_array_equal(part.position, whole.position[: len(part.position)])
        assert len(part.position) == min(n_env, 48)
    gsb_record(
        "--sim", "mujoco", "--scene", "cube-toss", "--initial", "random:0.1", "--n-env", "2", "--runs", "1",
        "--phases", "capture", "--out", tmp_path, code=0,
    )  # fmt: skip
    found = errors_of(Recording(next(tmp_path.glob("*.mcap"))), measured)
    assert "begins as no toss" in found.reason


def test_outputs(reference: Path, runs: dict[str, Path], tmp_path: Path, gsb_eval: Command) -> None:
    """Show the errors, the comparison and the floor in the report, and the error in the short answer."""
    done = gsb_eval(
        reference, runs["elliptic"], runs["pyramidal"], "--all", "--html", tmp_path, "--json", tmp_path / "e.json"
    )
    assert done.returncode == 0, done.stderr
    assert "Errors against synthetic tosses" in done.stdout
    assert "The rows of the set leave" in done.stdout
    record = json.loads((tmp_path / "e.json").read_text(encoding="utf-8"))
    extra = record["groups"][0]["metrics"]["toss_position"]["extra"]
    assert extra["tosses"] == 48
    assert "per_toss" not in extra
    short = gsb_eval(reference, runs["elliptic"]).stdout
    assert "of 48 tosses; error of rotation" in " ".join(short.split())
    alone = json.loads(gsb_eval(runs["elliptic"], "--json", "-").stdout)
    assert alone["groups"][0]["metrics"]["toss_position"]["value"] is None


def test_beside_other_scenes(reference: Path, runs: dict[str, Path], small: Path, gsb_eval: Command) -> None:
    """Show groups of tosses beside groups of other scenes, and compare each scene with its own reference alone."""
    shown = gsb_eval(reference, runs["elliptic"], small, "--sample-time", "1").stdout
    (of_tosses,), (of_others,) = (
        re.findall(rf"^{scene} on .*\n.*\n(.*)$", shown, re.MULTILINE) for scene in ("cube-toss", "inclined-collision")
    )
    assert re.search(r"\d cm$", of_tosses.rstrip())
    assert " cm" not in of_others
    assert "that only gsb-probe needs" not in shown


def test_paired() -> None:
    """Tell a shift of all cases from none, and be the negative of the other way round."""
    rng = np.random.default_rng(3)
    a = rng.gamma(2.0, size=60)
    b = a + rng.normal(0.2, 0.3, size=60)
    found, back = paired(b, a), paired(a, b)
    assert found.p_value < 0.001
    assert found.ci95[0] < found.mean < found.ci95[1]
    assert back.mean == pytest.approx(-found.mean)
    assert back.p_value == pytest.approx(found.p_value, abs=0.01)
    assert paired(a, a) == paired(b, b)
    assert paired(a, a).p_value == 1.0
    for wrong in (([], []), ([1.0], [1.0, 2.0]), ([math.nan], [1.0])):
        with pytest.raises(ValueError, match="values"):
            paired(*wrong)


def test_visible() -> None:
    """Reject a shift of the size that is called visible nearly always, and half of it much less often."""
    rng = np.random.default_rng(7)
    noise = [rng.normal(size=(2, 40)) for _ in range(60)]
    size = float(np.mean([paired(*one).visible or 0.0 for one in noise]))
    seen = [
        sum(paired(a + shift, b, seed=at).p_value <= 0.05 for at, (a, b) in enumerate(noise)) / 60
        for shift in (size, size / 2)
    ]
    assert seen[0] > 0.85
    assert seen[1] < 0.75


def test_false_alarms() -> None:
    """Reject exchangeable cases no more often than the level says."""
    rng = np.random.default_rng(5)
    p = [paired(*rng.normal(size=(2, 20)), seed=seed).p_value for seed in range(200)]
    assert 1 <= sum(one <= 0.05 for one in p) <= 20


@given(st.lists(st.floats(-5, 5), min_size=8, max_size=30))
def test_interval(values: list[float]) -> None:
    """Enclose nothing but what the values span; of too few there is none."""
    found = mean_interval(values)
    assert min(values) - 1e-9 <= found[0] <= found[1] <= max(values) + 1e-9
    assert mean_interval(values[:7]) is None
    for wrong in ([values], values[0]):
        with pytest.raises(ValueError, match="shape"):
            mean_interval(wrong)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: replace(t, position=np.full_like(t.position, np.nan)), "not all finite"),
        (
            lambda t: replace(t, known=replace(t.known, rows=(9999, *t.known.rows[1:]))),
            "9999 rows, more than are recorded",
        ),
        (lambda t: replace(t, known=replace(t.known, rows=t.known.rows[1:])), "47 tosses, and the recording"),
        (lambda t: replace(t, known=replace(t.known, length_scale=1e9)), "length_scale"),
    ],
    ids=["nan", "rows", "tosses", "scale"],
)
def test_a_reference_that_cannot_be(
    change: Callable[[Tosses], Tosses], said: str, runs: dict[str, Path], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, gsb_record: Command, gsb_eval: Command,
) -> None:  # fmt: skip
    """Evaluate without a reference whose tosses contradict themselves, and say why."""
    whole = read_tosses(None)
    broken = change(whole)
    monkeypatch.setattr(Tosses, "__len__", lambda self: len(whole.known.rows))
    monkeypatch.setattr(Tosses, "steps", lambda self, scene: 441)
    monkeypatch.setattr("gpusimbench.recorder.trials.real.read_tosses", lambda path: broken)
    assert gsb_record("--sim", "real", "--scene", "cube-toss", "--out", tmp_path).returncode == 0
    done = gsb_eval(*tmp_path.glob("*.mcap"), runs["elliptic"], code=0)
    assert said in " ".join(done.stdout.split())
    assert "cannot be used" in done.stdout


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_few_cases(count: int) -> None:
    """Give of a few cases the mean and p, an interval from eight on, and of one case nothing that it would show."""
    found = paired(np.arange(1.0, count + 1.0), np.zeros(count))
    assert (found.mean, found.cases) == ((count + 1) / 2, count)
    assert found.p_value == pytest.approx(2.0 / 2**count)
    assert (found.ci95 is not None) is (count == 8)
    of_numbers = np.sqrt((count + 1) / 12.0)  # SD of 1, 2, ..., count over the root of their count
    quantiles = stats.t.ppf(0.975, count - 1) + stats.t.ppf(0.95, count - 1)
    assert found.visible == (None if count == 1 else pytest.approx(quantiles * of_numbers))
