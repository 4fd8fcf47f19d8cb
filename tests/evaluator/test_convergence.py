"""The order of convergence in the time step: known orders are found, and what is no order is not called one."""

from __future__ import annotations

import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Document, Table
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.brief import brief
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.sections import convergence as page
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.convergence import Convergence, Order, fit_order
from gpusimbench.evaluator.results.evaluate import evaluate_files
from tests.conftest import recorded
from tests.scripts import drawn, script

_STEPS = np.array([0.04, 0.02, 0.01, 0.005])


def shown(document: Document) -> str:
    """What a terminal shows."""
    stream = io.StringIO()
    print_document(document, stream)
    return stream.getvalue()


def fitted(found: Order | Missing) -> Order:
    """An order that must be there."""
    assert isinstance(found, Order), found
    return found


@pytest.mark.parametrize("order", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("finest", [0.0, 0.0025])
def test_a_known_order_is_found(order: float, finest: float) -> None:
    """Find the order of errors C h^p against the exact motion, and of C (h^p - h0^p) against a finer step."""
    scale = np.linspace(0.5, 2.0, 16)
    errors = scale * (_STEPS**order - finest**order)[:, None]
    found = fitted(fit_order(_STEPS, errors, finest=finest))
    assert found.order == pytest.approx(order, abs=1e-4)
    assert found.asymptotic
    assert not isinstance(found.ci95, Missing)
    assert found.ci95 == pytest.approx((order, order), abs=1e-3)


@pytest.mark.parametrize("envs", [8, 24])
def test_the_interval_covers_the_order(envs: int) -> None:
    """Cover the order in about 95 % of 400 sets of environments whose errors vary by half; plain percentiles of 8
    environments do in 87 %."""
    draw, covered = np.random.default_rng(5), 0
    for seed in range(400):
        errors = _STEPS[:, None] * np.exp(0.5 * draw.standard_normal((4, envs)))
        # the truth is the order of the root mean square over all environments there could be, which is 1
        found = fitted(fit_order(_STEPS, errors, seed=seed)).ci95
        assert not isinstance(found, Missing)
        covered += found[0] <= 1.0 <= found[1]
    assert 0.91 * 400 <= covered <= 0.98 * 400


def test_the_order_is_that_of_scipys_minimum() -> None:
    """Fit the same order as SciPy's minimiser does, to four digits, against a finer step."""
    errors = (_STEPS**2 - 0.0025**2) * np.array([1.1, 0.8, 1.2, 0.9])

    def missed(p: float) -> float:
        return float(np.var(np.log(errors) - np.log(_STEPS**p - 0.0025**p)))

    least = minimize_scalar(missed, bounds=(0.05, 8.0), method="bounded", options={"xatol": 1e-7}).x
    assert fitted(fit_order(_STEPS, errors[:, None], finest=0.0025)).order == pytest.approx(least, abs=1e-4)


def test_errors_that_stop_falling_have_no_order() -> None:
    """Say that local orders disagree where a rounding error of 1e-4 lies below errors of second order."""
    errors = np.tile((_STEPS**2 + 1e-4)[:, None], (1, 8))
    found = fitted(fit_order(_STEPS, errors))
    assert not found.asymptotic
    assert found.local[0] > 1.5 > 1.0 > found.local[-1]
    assert found.ci95 == Missing("the environments are alike")


def test_errors_that_never_fall_have_no_order() -> None:
    """Say so too where rounding alone is left, and all local orders agree at the end of what is looked for."""
    errors = np.tile(np.array([1.3e-6, 1.2e-6, 0.9e-6, 1.0e-6])[:, None], (1, 8))
    found = fitted(fit_order(_STEPS, errors, finest=0.0025))
    assert "hides that of the method" in found.order.reason
    assert all(isinstance(one, Missing) for one in found.local)
    assert found.ci95 == Missing("there is no order")
    assert not found.asymptotic
    one = Convergence("warp", "pendulum", 1.0, 0.0025, "joints", "rad", found)
    assert page.said(one) == "-"
    assert page.said_locally(found) == "-, -, -"
    assert page.sentence(one).endswith(f"not known: {found.order.reason}")
    make = script("make_convergence")
    assert make.row(one, "warp", make.Engine("pendulum", "warp", order=4)).endswith(
        f"| - | 4 | -, -, - | {found.order.reason} |"
    )


@pytest.mark.parametrize(
    ("steps", "errors", "why"),
    [
        ([0.2, 0.1], [[1.0], [0.5]], "an order needs errors at 3 steps or more, and there are 2"),
        ([0.3, 0.2, 0.1], [[1.0], [0.0], [0.5]], "there is no error at a step of 0.2 s"),
        ([0.3, 0.2, 0.1], [[1.0], [np.nan], [0.5]], "an error is not finite"),
    ],
)
def test_what_has_no_order_says_why(steps: list[float], errors: list[list[float]], why: str) -> None:
    """Give a reason instead of a number."""
    assert fit_order(steps, errors) == Missing(why)


def test_steps_that_are_none_are_refused() -> None:
    """Refuse equal steps, a finest step that is not the smallest, and shapes that do not fit."""
    for steps, errors, finest in (([1, 1, 2], np.ones((3, 1)), 0.0), ([1, 2, 3], np.ones((3, 1)), 1.0),
                                  ([1, 2, 3], np.ones((2, 1)), 0.0)):  # fmt: skip
        with pytest.raises(ValueError, match="step"):
            fit_order(steps, errors, finest=finest)


@pytest.fixture(scope="module")
def pendulums() -> list[Path]:
    """A pendulum from eight angles, by two integrators of MuJoCo C at four steps, until 1 s."""
    return [
        path
        for integrator in ("Euler", "RK4")
        for dt in _STEPS
        for path in recorded(
            "--sim", "mujoco", "--scene", "pendulum", "--n-env", 8, "--runs", 1, "--phases", "capture", "--dt", dt,
            "--steps", round(1 / dt), "--stride", round(1 / dt), "--initial", "random:0.8",
            "--option", f"integrator={integrator}", "--no-view",
        )
    ]  # fmt: skip


@pytest.mark.slow
def test_integrators_of_mujoco_have_their_orders(pendulums: list[Path]) -> None:
    """Find 1 for semi-implicit Euler and 4 for Runge-Kutta on a pendulum, from recordings alone, and show both."""
    evaluation = evaluate_files(pendulums, sample_time=1.0)
    by_label = {one.label: one for one in evaluation.convergences}
    assert len(by_label) == 2
    for integrator, order, within in (("Euler", 1.0, 0.1), ("RK4", 4.0, 0.2)):  # 40 ms is long for the fourth order
        (one,) = (one for label, one in by_label.items() if integrator in label)
        assert (one.what, one.unit, one.finest, one.left_out) == ("joints", "rad", 0.005, ())
        found = fitted(one.found)
        assert found.order == pytest.approx(order, abs=within)
        assert found.asymptotic
        assert not isinstance(found.ci95, Missing)
        assert found.ci95[0] < found.order < found.ci95[1]
    section = page.section(Source(evaluation, False, ""))
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert len(table.rows) == 2
    assert f"order of convergence in dt {found.order:.2f} [" in shown(brief(evaluation))  # of RK4
    document = json.loads(json.dumps(to_json(evaluation)["convergence"], allow_nan=False))
    assert sorted(round(one["order"]) for one in document) == [1, 4]


@pytest.mark.slow
def test_a_step_that_misses_the_time_is_left_out(pendulums: list[Path]) -> None:
    """Leave out steps of which no whole number makes the time, with the reason, and fit nothing to the rest."""
    euler = pendulums[:4]
    (one,) = evaluate_files(euler, sample_time=0.98).convergences
    assert isinstance(one.found, Missing)
    assert any("0.04 s: 0.98 s is no whole number of steps" in why for why in one.left_out)
    assert evaluate_files(euler[:3], sample_time=1.0).convergences == ()


def test_engines_that_were_not_measured_anew_keep_their_rows(tmp_path: Path) -> None:
    """Draw the page as it is where nothing was recorded, and the new row of an engine that refuses by now."""
    make = script("make_convergence")
    shown = drawn(make.PAGE, "convergence").strip()
    assert make.table(tmp_path, shown) == shown
    engine = next(one for one in make.ENGINES if one.simulator == "genesis" and one.scene == "pendulum")
    (tmp_path / f"{engine.folder(0)}.txt").write_text("no limit\n", encoding="utf-8")
    before, after = shown.splitlines(), make.table(tmp_path, shown).splitlines()
    (row,) = set(after) - set(before)
    assert row == f"| pendulum | {engine.label} | | | | | no limit |"
    assert len(after) == len(before) and len(set(before) - set(after)) == 1


@pytest.mark.slow
def test_a_row_says_what_was_found_or_why_an_engine_refused(pendulums: list[Path], tmp_path: Path) -> None:
    """Draw the order of an engine that was recorded, and the reason of one that takes no robots."""
    drawn = script("make_convergence")
    engine = next(one for one in drawn.ENGINES if one.simulator == "mujoco" and "integrator=RK4" in one.options)
    for dt, path in zip(drawn.STEPS, pendulums[4:], strict=False):
        (tmp_path / engine.folder(dt)).mkdir()
        shutil.copy(path, tmp_path / engine.folder(dt))
    refusing = next(one for one in drawn.ENGINES if one.simulator == "brax" and one.scene == "pendulum")
    (tmp_path / f"{refusing.folder(0)}.txt").write_text("it has no hinge joints\n", encoding="utf-8")
    found, refused = ([cell.strip() for cell in row.split("|")[1:-1]] for row in drawn.rows(tmp_path))
    assert found[:2] == ["pendulum, joints [rad] at 1 s", "mujoco [integrator=RK4]"]
    assert found[3].startswith("3.8") and found[4] == "4" and found[-1] == ""
    assert refused == ["pendulum", "brax [solver generalized]", "", "", "", "", "it has no hinge joints"]
