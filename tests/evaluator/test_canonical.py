"""Scenes with closed-form answers: what a run did, what mechanics predicts, and what would have been noticed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import chi2, mannwhitneyu, t

from gpusimbench import open_recording
from gpusimbench.evaluator.metrics.physics.closed_form import pendulum_period, stopping_distance
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.state_array import StateArray
from gpusimbench.evaluator.render.document import Table, Tone
from gpusimbench.evaluator.report.sections.mechanics import change
from gpusimbench.evaluator.report.sections.overview import overview
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.report.verdicts import for_probe, kept
from gpusimbench.evaluator.results.canonical import Law, Unmeasured, breaking_move, laws, showing_move
from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.results.faults import faults_anywhere
from gpusimbench.evaluator.runs.physics.facts import LawValues, PhysicsFacts
from gpusimbench.evaluator.runs.physics.laws import laws_of
from gpusimbench.evaluator.statistics.cases import variation
from tests.conftest import call

_COMMON = ("--sim", "mujoco", "--n-env", "12", "--runs", "1", "--phases", "capture", "--seed", "3")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A pendulum, and blocks at a step of 2 ms and of 10 ms, on MuJoCo C; every environment begins otherwise."""
    folder = tmp_path_factory.mktemp("canonical")
    asked = {
        "pendulum": ("--scene", "pendulum", "--initial", "random:1.0"),
        "blocks": ("--scene", "sliding-block", "--initial", "random:0.5", "--dt", "0.002", "--steps", "1000"),
        "coarse": ("--scene", "sliding-block", "--initial", "random:0.5"),
    }
    found = {}
    for name, options in asked.items():
        done = call("gsb-record", *_COMMON, *options, "--out", folder / name, code=0)
        found[name] = Path(done.stdout.split()[0])
    return found


def _laws(path: Path) -> dict[str, dict[str, object]]:
    done = call("gsb-eval", path, "--json", "-", code=0)
    (group,) = json.loads(done.stdout)["groups"]
    return {law["key"]: law for law in group["laws"]}


@pytest.mark.parametrize("amplitude", [0.01, 1.0, 2.5, 3.1])
def test_the_period_is_the_elliptic_integral(amplitude: float) -> None:
    """Agree with 2/pi K(sin(a/2)) by quadrature of the integral itself."""
    k = math.sin(amplitude / 2)
    integral, _ = quad(lambda t: 1 / math.sqrt(1 - (k * math.sin(t)) ** 2), 0, math.pi / 2, epsabs=1e-12)
    assert float(pendulum_period(np.array([amplitude]), 2.0)[0]) == pytest.approx(4 / math.pi * integral, rel=1e-9)


def test_a_block_stops_where_its_speed_is_spent() -> None:
    """Agree with small steps of v dv = -d ds."""
    speed, way, step = 2.0, 0.0, 1e-5
    while speed > 0:
        way, speed = way + speed * step, speed - 3.0 * step
    assert float(stopping_distance(np.array([2.0]), -3.0)[0]) == pytest.approx(way, rel=1e-4)


def test_environments_begin_on_their_own_and_along_the_planks(recorded: dict[str, Path]) -> None:
    """Draw an angle for each pendulum, a speed along its plank for each launched block, and nothing for the others."""
    angles = open_recording(recorded["pendulum"]).state("robot", "qpos").read(slice(0, 1), slice(None))[0, :, 0, 0]
    assert len(set(angles.tolist())) == 12 and np.ptp(angles) > 0.5
    blocks = open_recording(recorded["blocks"]).state("cubes", "linear_velocity").read(slice(0, 1), slice(None))[0]
    tilt = np.radians([0.0, 8.0, -8.0])
    along = np.stack([np.cos(tilt), 0 * tilt, -np.sin(tilt)], axis=-1)
    speed = (blocks[:, :3] * along).sum(axis=-1)
    assert np.allclose(blocks[:, :3], speed[..., None] * along, atol=1e-12)
    assert np.ptp(speed, axis=0).min() > 0.3 and speed.min() >= 1.5 and speed.max() <= 2.5
    assert not blocks[:, 3:].any()


def test_mujoco_keeps_the_laws_of_the_pendulum(recorded: dict[str, Path]) -> None:
    """Hold the period and the energy, and say what neither depends on."""
    found = _laws(recorded["pendulum"])
    assert set(found) == {"period", "energy_change"}
    assert all(law["held"] and law["count"] == 12 for law in found.values())
    assert abs(found["period"]["difference"]) < 1e-3  # type: ignore[arg-type]
    least = {one["parameter"]: one["least"] for one in found["period"]["sensitivities"]}  # type: ignore[attr-defined]
    assert least == {"mass": None, "damping": None}
    least = {one["parameter"]: one["least"] for one in found["energy_change"]["sensitivities"]}  # type: ignore[attr-defined]
    assert least["mass"] is None and 0 < least["damping"] < 1e-3


def test_mujoco_brakes_right_and_creeps(recorded: dict[str, Path]) -> None:
    """Hold every acceleration at a short step, and see the creep of a block that should stick."""
    found = _laws(recorded["blocks"])
    names = ("level", "downhill", "uphill")
    assert set(found) == {f"{n}_{w}" for n in names for w in ("acceleration", "distance")} | {
        "stick_creep", "slip_acceleration",
    }  # fmt: skip
    assert all(found[f"{name}_acceleration"]["held"] for name in (*names, "slip"))
    assert found["stick_creep"]["difference"] > 5e-4 and not found["stick_creep"]["held"]  # type: ignore[operator]
    coarse = _laws(recorded["coarse"])["level_acceleration"]
    for law in (found["level_acceleration"], coarse):
        assert law["predicted"] == pytest.approx(-0.3 * 9.81)
    assert abs(coarse["difference"]) > 5 * abs(found["level_acceleration"]["difference"])  # type: ignore[arg-type]


def test_laws_are_printed(recorded: dict[str, Path]) -> None:
    """Name the broken laws in the short output, and the smallest change that shows in the long one."""
    said = " ".join(call("gsb-eval", recorded["pendulum"]).stdout.split())
    assert "mujoco: 2 of 2 laws in closed form held" in said and "BROKEN" not in said
    said = " ".join(call("gsb-eval", recorded["blocks"]).stdout.split())
    assert "laws in closed form held; BROKEN:" in said and "creep of the block that sticks on 12 degrees 0.001" in said
    said = call("gsb-eval", recorded["pendulum"], "--all").stdout
    assert "insensitive" in said and "damping" in said


def test_laws_stand_on_the_first_screen(recorded: dict[str, Path]) -> None:
    """Answer for each simulator whether the laws hold, although the environments of such runs begin in drawn states."""
    evaluation = evaluate_files([recorded["pendulum"], recorded["blocks"]])
    assert not any(for_probe(result) for result in evaluation.results)
    (matrix,) = (
        block for block in overview(Source(evaluation, False, "")) if getattr(block, "key", "") == "simulators"
    )
    assert isinstance(matrix, Table)
    titles = [column.title for column in matrix.columns]
    cell = matrix.rows[0].cells[titles.index("laws in closed form")]
    judged = sum(isinstance(law, Law) and law.held is not None for r in evaluation.results for law in r.laws)
    broken = sum(not law.held for result in evaluation.results for law in result.laws if isinstance(law, Law))
    assert (cell.text, cell.notes) == ("no", (f"{broken} of {judged} laws broken",))


def test_laws_that_were_not_measured_stand_beside_those_that_hold(recorded: dict[str, Path], tmp_path: Path) -> None:
    """Say of how many laws a yes is, and what was not measured in which groups; "all" where every law was measured."""
    asked = (*_COMMON, "--scene", "pendulum", "--steps", 20)
    short = call("gsb-record", *asked, "--dt", "0.02", "--out", tmp_path / "a", code=0).stdout.split()[0]
    asked = (*asked, "--scene", "double-pendulum", "--vary", "mass:0.1")
    varied = call("gsb-record", *asked, "--out", tmp_path / "b", code=0).stdout.split()[0]
    results = evaluate_files([recorded["pendulum"], Path(short), Path(varied)]).results
    whole, *_ = (result for result in results if all(isinstance(law, Law) for law in result.laws))
    assert (kept([whole]).text, kept([whole]).notes) == ("yes", ("all 2 laws",))
    cell = kept(results)
    assert (cell.text, cell.tone) == ("yes", Tone.WARNING)
    held, missing = cell.notes
    laws = [law for result in results for law in result.laws]
    n, of = sum(isinstance(law, Law) for law in laws), sum(isinstance(law, Law) or bool(law.key) for law in laws)
    assert held == f"{n} of {of} laws" and n < of
    assert missing.startswith("not measured: ") and "period of the pendulum in 1 of 2 groups" in missing
    assert "all laws of double-pendulum" in missing and "double-pendulum in" not in missing


@pytest.mark.slow
def test_a_broken_law_is_held_against_other_scenes(recorded: dict[str, Path], tmp_path: Path) -> None:
    """Hold it against the same engine at the same step alone, and name it in a leaderboard."""
    for name, options in (
        ("same", ("--dt", "0.002")), ("step", ("--dt", "0.001")),
        ("cone", ("--dt", "0.002", "--option", "cone=pyramidal")),
    ):  # fmt: skip
        asked = ("--sim", "mujoco", "--scene", "free-fall", "--n-env", "1", "--runs", "1", "--phases", "capture")
        call("gsb-record", *asked, "--steps", "20", *options, "--out", tmp_path / name, code=0)
    results = evaluate_files([recorded["blocks"], *sorted(tmp_path.glob("*/*.mcap"))]).results
    against = {
        (r.group.key.scene, r.group.key.dt, "pyramidal" in r.group.key.options): "; ".join(faults_anywhere(r, results))
        for r in results
    }
    said = "creep of the block that sticks on 12 degrees 0.001"
    assert said in against["sliding-block", 0.002, False]
    assert said in against["free-fall", 0.002, False]
    assert against["free-fall", 0.002, False].endswith("(sliding-block)")
    assert not any("laws" in against["free-fall", *other] for other in ((0.001, False), (0.002, True)))
    board = tmp_path / "board"
    call("gsb-share", "leaderboard", recorded["blocks"].parent, "--out", board, "--no-cache", code=5)
    (section,) = json.loads((board / "leaderboard.json").read_text())["sections"]
    assert said in section["rows"][0]["place_missing"]


@pytest.mark.parametrize(("name", "array"), [("pendulum", "qpos"), ("pendulum", "qvel"), ("blocks", "linear")])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e300])
def test_a_run_that_blew_up_says_why_it_has_no_laws(
    recorded: dict[str, Path], monkeypatch: pytest.MonkeyPatch, name: str, array: str, value: float
) -> None:
    """Give the reason, and fail at nothing, where one number is that of no motion."""

    def spoiled(read: Callable[..., Any]) -> Callable[..., Any]:
        def made(self: StateArray, *at: Any) -> Any:
            found = np.array(read(self, *at), dtype=np.float64)
            if array in self.field.field:
                found[-1] = value
            return found

        return made

    with monkeypatch.context() as patch:
        patch.setattr(StateArray, "read", spoiled(StateArray.read))
        assert laws_of(Recording(recorded[name])) == Missing("states are not finite")
    assert laws_of(Recording(recorded[name]))


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (("--scene", "pendulum", "--steps", "20"), "period of the pendulum: no whole period was recorded"),
        (
            ("--scene", "sliding-block", "--steps", "40", "--stride", "40"),
            "fewer than 6 states were recorded after 0.1 s",
        ),
        (("--scene", "pendulum", "--steps", "20", "--vary", "friction:0.1"), "other parameters than the scene"),
        (("--scene", "double-pendulum", "--steps", "20", "--vary", "mass:0.1"), "other parameters than the scene"),
        (("--scene", "pendulum", "--steps", "20", "--intervene", "reset@10"), "environments were changed on the way"),
    ],
)
def test_a_law_that_is_not_measured_says_why(tmp_path: Path, asked: tuple[str, ...], why: str) -> None:
    """Print the reason on the first page, in the table and in the JSON, where a recording is too short or changed."""
    done = call("gsb-record", *_COMMON, *asked, "--out", tmp_path, code=0)
    path = done.stdout.split()[0]
    for more in ((), ("--all",)):
        assert why.rpartition(": ")[2] in " ".join(call("gsb-eval", path, *more).stdout.split())
    (group,) = json.loads(call("gsb-eval", path, "--json", "-").stdout)["groups"]
    assert group["laws"] and all(law["missing"] for law in group["laws"])
    assert any(why in f"{law['title']}: {law['missing']}" for law in group["laws"])


def _values(measured: list[float], predicted: float = 1.0, slope: float = 2.0, tolerance: float = 0.01) -> PhysicsFacts:
    law = LawValues(
        "it",
        "it",
        "m",
        tuple(measured),
        (predicted,) * len(measured),
        tolerance,
        "none",
        (("friction", slope), ("mass", 0.0)),
        "it did not move",
    )
    return PhysicsFacts("pendulum", len(measured), ((0, len(measured) - 1),), {}, laws=(law,))


def test_a_planted_error_is_broken_and_none_is_held() -> None:
    """Tell a shift of ten standard errors beyond the tolerance from none; leave out what did not take place."""
    noise = np.random.default_rng(1).normal(0.0, 0.001, 50)
    (right,) = laws("a", [_values([*(1.0 + noise), math.nan])])
    assert isinstance(right, Law) and right.left_out == ("it did not move",)
    assert right.held and right.count == 50 and right.of_envs == 51
    (wrong,) = laws("a", [_values([*(1.02 + noise)])])
    assert (
        isinstance(wrong, Law)
        and not wrong.left_out
        and not wrong.held
        and wrong.difference == pytest.approx(0.02, abs=1e-3)
    )
    assert laws("a", [_values([math.nan] * 2)]) == (Unmeasured("a", "pendulum", "it", "it", "it did not move"),)
    unread = replace(_values([]), laws=Missing("too short"))
    assert laws("a", [unread, unread]) == (Unmeasured("a", "pendulum", "", "all laws of pendulum", "too short"),)


def test_runs_of_a_group_are_no_further_experiments() -> None:
    """Keep the interval as wide when the same environments are recorded ten times."""
    one = _values([1.0, 1.1, 0.9, 1.05])
    (once,), (often,) = laws("a", [one]), laws("a", [one] * 10)
    assert often.ci95 == pytest.approx(once.ci95)
    longer = replace(one, laws=(replace(one.laws[0], measured=(1.0,), predicted=(1.0,)),))
    (single,) = laws("a", [longer])
    assert single.ci95 is None and single.sensitivities[0].exact and single.sensitivities[0].least == 0.01 / 2.0


def test_the_smallest_changes_are_seen_95_times_in_100() -> None:
    """Detect changes of the two sizes that each sample claims, by counting, with an effect as uneven as the predicted
    values; a change of half the size far less often, and no change in 1 of 20 pairs and in no verdict."""
    n, sigma, count = 24, 0.3, 400
    rng = np.random.default_rng(5)
    predicted = np.linspace(0.8, 1.2, n)
    pairs, verdicts, half, none = [], [], [], []
    for _ in range(count):
        before = rng.normal(0.0, sigma, n)
        least, breaks = showing_move(before, variation(predicted)), breaking_move(before, variation(predicted), 0.2)
        assert least is not None

        def after(move: float) -> NDArray[np.float64]:
            return rng.normal(0.0, sigma, n) + move * predicted

        pairs.append(_differ(before, after(least)))
        half.append(_differ(before, after(least / 2)))
        none.append(_differ(before, after(0.0)))
        (law,) = laws("a", [_values(list(1.0 + after(-breaks)), tolerance=0.2)])
        (unchanged,) = laws("a", [_values(list(1.0 + after(0.0)), tolerance=0.2)])
        verdicts.append((not law.held, not unchanged.held))
    assert np.mean(pairs) > 0.95
    assert np.mean(half) < 0.8
    assert np.mean(none) == pytest.approx(0.05, abs=0.03)
    assert np.mean(verdicts, axis=0)[0] > 0.95 and not any(false for _, false in verdicts)


@pytest.mark.parametrize("uneven", [0.05, 0.4])
def test_the_smallest_changes_solve_their_equations(uneven: float) -> None:
    """Agree with the formulas of docs/physics/laws.md; the share by which effects differ is 10 % at least."""
    off, tolerance = np.random.default_rng(2).normal(0.01, 0.3, 30), 0.2
    n, k = len(off), max(uneven, 0.1)
    s = off.std(ddof=1) / math.sqrt(n) * math.sqrt((n - 1) / chi2.ppf(0.05, n - 1))  # its upper 95 % limit
    shown, breaks = showing_move(off, uneven), breaking_move(off, uneven, tolerance)
    q = t.ppf(0.975, 2 * n - 2) + t.ppf(0.95, 2 * n - 2)
    assert shown == pytest.approx(q * math.sqrt(math.pi / 3) * math.sqrt(2 * s**2 + k**2 * shown**2 / n))
    q = t.ppf(0.975, n - 1) + t.ppf(0.95, n - 1)
    assert breaks == pytest.approx(tolerance + abs(off.mean()) + q * (s + k * breaks / math.sqrt(n)))


def _differ(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    return bool(mannwhitneyu(one, other).pvalue < 0.05)


def test_a_law_that_is_broken_claims_no_breaking_change_and_two_environments_too_little() -> None:
    """Leave out what cannot be claimed, and say why in words."""
    (broken,) = laws("a", [_values([1.5, 1.501, 1.499, 1.5])])
    assert not broken.held and broken.sensitivities[0].breaks is None
    (few,) = laws("a", [_values([1.0, 1.1], tolerance=1e-3)])
    assert breaking_move(np.array([-0.1]), 0.4, 0.25) == pytest.approx(0.35)  # nothing but the tolerance is left
    assert few.sensitivities[0].breaks is None and few.sensitivities[0].slope == 2.0
    assert change(few.sensitivities[1]) == "insensitive to mass"
    (rough,) = laws("a", [_values([1.0, 2.0, 0.0, 1.0])])
    assert rough.sensitivities[0].least is None and rough.held
    assert change(rough.sensitivities[0]) == "no friction up to 20 % is sure to show"
