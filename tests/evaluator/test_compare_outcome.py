"""What two sides say of where cubes end, from the distances between their runs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench.evaluator.compare.distances import Distances
from gpusimbench.evaluator.compare.finding import Change, Finding, Settings
from gpusimbench.evaluator.compare.outcome import compare_outcomes, compare_spread
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.metrics import METRICS

W1 = METRICS["w1_run_to_run"]
SETTINGS = Settings()


def between(base: float, head: float, apart: float, n: tuple[int, int] = (3, 3)) -> NDArray[np.float64]:
    """Distances [cm] that are the same within base, within head, and between the two, shape [run, run]."""
    sides = np.repeat([0, 1], n)
    matrix = np.where(sides[:, None] != sides, apart, np.where(sides, head, base))
    np.fill_diagonal(matrix, 0.0)
    return matrix


@pytest.mark.parametrize(("apart", "change"), [(0.01, Change.SMALL), (0.010001, Change.CHANGED)])
def test_runs_of_a_side_that_are_alike(apart: float, change: Change) -> None:
    """Hold the two outcomes against what matters, where each side has one."""
    found = Distances(between(0.0, 0.0, apart, (2, 2)), "cm", (2, 2), exact=True, alike=(True, True), same=False)
    outcome = compare_outcomes(found, SETTINGS, applies=True)
    assert isinstance(outcome, Finding)
    assert (outcome.change, outcome.said) == (change, ("0 within base", f"0 within head, {apart:.3g} between them"))
    spread = compare_spread(W1, found, SETTINGS, applies=True)
    assert isinstance(spread, Finding)
    assert (spread.change, spread.ratio) == (Change.SAME, None)


def test_runs_that_are_one_on_both_sides() -> None:
    """Need no second run of a side to see that two runs end the same."""
    found = Distances(between(0.0, 0.0, 0.0, (1, 1)), "cm", (1, 1), exact=True, alike=(True, True), same=True)
    outcome = compare_outcomes(found, SETTINGS, applies=True)
    assert isinstance(outcome, Finding)
    assert outcome.change is Change.SAME


@pytest.mark.parametrize("n", [(1, 3), (3, 1)])
def test_one_run_of_a_side(n: tuple[int, int]) -> None:
    """Compare nothing where a side has a single run that is not the other's."""
    found = Distances(between(1.0, 1.0, 2.0, n), "cm", n, exact=True, alike=(n[0] == 1, n[1] == 1), same=False)
    for finding in (compare_outcomes(found, SETTINGS, applies=True), compare_spread(W1, found, SETTINGS, applies=True)):
        assert isinstance(finding, Finding)
        assert (finding.change, finding.applies) == (Change.NOT_COMPARED, True)
    assert found.within() == ((None, 1.0) if n[0] == 1 else (1.0, None))


@pytest.mark.parametrize(
    ("base", "head", "change"),
    [
        (1.0, 1.2, Change.REGRESSION),
        (1.2, 1.0, Change.IMPROVEMENT),
        (1.0, 1.04, Change.SMALL),
        (0.001, 0.002, Change.SMALL),
    ],
)
def test_a_spread_that_changes(base: float, head: float, change: Change) -> None:
    """Count a change by more than the threshold, and by a length that matters; leave both ways open without a test."""
    found = Distances(between(base, head, 3.0), "cm", (3, 3), exact=True, alike=(False, False), same=False)
    asked = compare_spread(W1, found, SETTINGS, applies=True)
    assert callable(asked)
    shown, not_shown = asked(0.05, able=True)
    assert (shown.change, shown.base, shown.head) == (change, pytest.approx(base), pytest.approx(head))
    assert shown.ratio == pytest.approx(head / base)
    assert (not_shown.change, not_shown.left_open) == (Change.UNCLEAR, ())
    assert asked(0.05, able=False)[1].left_open == (Change.REGRESSION, Change.IMPROVEMENT)


@pytest.mark.parametrize(("apart", "change"), [(1.005, Change.SMALL), (1.02, Change.CHANGED)])
def test_outcomes_that_are_further_apart_than_runs(apart: float, change: Change) -> None:
    """Count what runs of different sides are further apart than runs of one side."""
    found = Distances(between(1.0, 1.0, apart), "cm", (3, 3), exact=True, alike=(False, False), same=False)
    asked = compare_outcomes(found, SETTINGS, applies=True)
    assert callable(asked)
    shown, not_shown = asked(0.05, able=False)
    assert (shown.change, shown.p_value, shown.least_p) == (change, pytest.approx(0.1), pytest.approx(0.1))
    assert (not_shown.change, not_shown.left_open) == (Change.UNCLEAR, (Change.CHANGED,))


@pytest.mark.parametrize("applies", [True, False])
def test_positions_that_are_not_there(applies: bool) -> None:
    """Give the reason, and whether there was anything to compare; nothing where no states were captured."""
    for compare in (compare_outcomes, lambda *given, applies: compare_spread(W1, *given, applies=applies)):
        assert compare(None, SETTINGS, applies=applies) is None
        finding = compare(Missing("too large"), SETTINGS, applies=applies)
        assert isinstance(finding, Finding)
        assert (finding.why_not, finding.applies) == ("too large", applies)


def test_mean_distances_within_the_sides() -> None:
    """Average over pairs of different runs of each side, and over none of a single run."""
    matrix = np.array([[0.0, 1.0, 2.0, 9.0], [1.0, 0.0, 6.0, 9.0], [2.0, 6.0, 0.0, 9.0], [9.0, 9.0, 9.0, 0.0]])
    assert Distances(matrix, "cm", (3, 1), exact=True, alike=(False, True), same=False).within() == (3.0, None)
    assert Distances(matrix[:, ::-1][::-1], "cm", (2, 2), exact=True, alike=(False, False), same=False).within() == (
        9.0,
        1.0,
    )
