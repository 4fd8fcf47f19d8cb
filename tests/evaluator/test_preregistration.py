"""The announced comparison: its power is what it says, its verdicts follow its rules, and what is missing is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.results.evaluate import evaluate_files
from gpusimbench.evaluator.statistics.cases import Paired
from tests.conftest import recorded
from tests.scripts import script


@pytest.fixture(scope="module")
def making() -> Any:
    """docs/make_preregistration.py."""
    return script("make_preregistration")


def test_power_is_the_share_of_sets_that_show_the_difference(making: Any) -> None:
    """Agree with 20,000 drawn sets of 570 normal differences on both powers, to 1 %."""
    spread, draw = 0.7, np.random.default_rng(3)
    half = making.z(1 - 0.05 / 9 / 2) * spread / 570**0.5
    means = draw.normal(0.0, spread / 570**0.5, 20_000)
    shows, equivalent = making.power(spread)
    assert shows == pytest.approx(np.mean(np.abs(means + making.LEAST) > half), abs=0.01)
    assert equivalent == pytest.approx(np.mean(np.abs(means) + half < making.LEAST), abs=0.01)


@pytest.mark.parametrize(
    ("mean", "error", "p", "verdict"),
    [
        (0.5, 0.01, 0.001, "**larger**"),
        (-0.5, 0.01, 0.001, "**smaller**"),
        (0.05, 0.01, 0.001, "larger, by less than matters"),
        (0.0, 0.01, 1.0, "equivalent"),
        (0.05, 0.1, 1.0, "undecided"),
    ],
)
def test_verdicts_follow_the_rules(making: Any, mean: float, error: float, p: float, verdict: str) -> None:
    """Judge by the adjusted p and by the simultaneous interval."""
    found = Paired(mean, None, p, 570, None)
    assert making.Contrast("x", "solver", "CG", None, None, found, error, p).verdict == verdict


def test_what_was_not_recorded_keeps_its_place(making: Any) -> None:
    """Judge the contrast that was recorded by Holm's method for nine, and name the other eight."""
    toss = ("--scene", "cube-toss", "--runs", 1, "--phases", "capture")
    files: list[Path] = [
        *recorded("--sim", "real", "--scene", "cube-toss"),
        *recorded("--sim", "mujoco", *toss),
        *recorded("--sim", "mujoco", *toss, "--option", "solver=CG"),
    ]
    evaluation = evaluate_files(files, sample_time=making.SAMPLE_TIME)
    (one,), missing = making.contrasts(evaluation.results)
    assert (one.simulator, one.option, one.value, one.found.cases) == ("mujoco", "solver", "CG", 48)
    assert one.p_value == min(1.0, 9 * one.found.p_value)
    assert one.found.mean == pytest.approx(
        np.mean(list(making.errors_by_toss(one.changed).values()))
        - np.mean(list(making.errors_by_toss(one.usual).values()))
    )
    assert "mujoco integrator=RK4: no recording of integrator=RK4 has errors" in missing
    assert "mjx solver=CG: no recording of default has errors" in missing
    drawn = making.result_table(evaluation)
    assert "| mujoco " in drawn
    assert "Not judged: warp solver=CG: no recording of solver=CG has errors." in drawn
