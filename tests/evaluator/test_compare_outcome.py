"""What two sides say of where cubes end, from the distances between their runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gpusimbench import open_recording
from gpusimbench.evaluator.compare.finding import Change, Settings
from gpusimbench.evaluator.compare.outcome import (
    Distances,
    compare_outcomes,
    compare_spread,
    distances,
    has_positions,
    joint_distances,
)
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import read_run
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.recorder.log import RecordingWriter
from gpusimbench.schemas.fields import body_field, joint_field

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
    assert (outcome.change, outcome.said) == (change, ("0 within base", f"0 within head, {apart:.3g} between them"))
    spread = compare_spread(W1, found, SETTINGS, applies=True)
    assert (spread.change, spread.ratio) == (Change.SAME, None)


def test_runs_that_are_one_on_both_sides() -> None:
    """Need no second run of a side to see that two runs end the same."""
    found = Distances(between(0.0, 0.0, 0.0, (1, 1)), "cm", (1, 1), exact=True, alike=(True, True), same=True)
    outcome = compare_outcomes(found, SETTINGS, applies=True)
    assert outcome.change is Change.SAME


@pytest.mark.parametrize(
    ("base", "head", "alike", "same"),
    [
        ((0, 0), (1, 2), (True, False), False),
        ((1, 2), (0, 0), (False, True), False),
        ((0, 0, 0), (0, 0), (True, True), True),
        ((0, 1), (0, 2), (False, False), True),
        ((0,), (1,), (True, True), False),
    ],
)
def test_which_runs_are_alike(
    base: tuple[int, ...], head: tuple[int, ...], alike: tuple[bool, bool], same: bool, tmp_path: Path
) -> None:
    """Say of either side whether its runs are equal, and whether both begin with the same run: of positions, of joints,
    in the unit that is asked for."""
    sides = []
    for name, kinds in (("base", base), ("head", head)):
        runs = []
        for number, kind in enumerate(kinds):
            path = tmp_path / f"{name}{number}.mcap"
            with RecordingWriter(
                path, simulator="mine", version="1", scene="cart", n_env=2, dt=0.1, steps=1,
                fields=(
                    body_field("bodies", "position", "float64", ("body",)),
                    joint_field("joints", "qpos", "float64", ("hinge",)),
                ),
            ) as log:  # fmt: skip
                states = np.arange(4.0).reshape(2, 2, 1, 1) + 0.01 * kind
                log.append(np.repeat(states, 3, axis=-1), states)
            runs.append(read_run(open_recording(path), 0.1))
        sides.append(runs)
    for found, apart in (
        (distances(*sides, Work()), 100 * 0.01 * np.sqrt(2)),
        (joint_distances(*sides, "rad"), 0.01),
    ):
        assert (found.n, found.alike, found.same, found.exact) == ((len(base), len(head)), alike, same, True)
        kinds = np.array([*base, *head])
        assert found.matrix == pytest.approx(abs(kinds[:, None] - kinds) * apart, abs=1e-9)
    assert joint_distances(*sides, "cm") is None
    assert [has_positions(*given) for given in (sides, (sides[0], []), ([], sides[1]), ([], []))] == [True] * 4


def test_runs_without_positions_have_nothing_to_compare(tmp_path: Path) -> None:
    """Decide nothing where both sides have runs and none recorded positions; a side without runs stays open."""
    path = tmp_path / "a.mcap"
    fields = (joint_field("joints", "qpos", "float64", ("hinge",)),)
    with RecordingWriter(
        path, simulator="mine", version="1", scene="cart", n_env=2, dt=0.1, steps=1, fields=fields
    ) as log:
        log.append(np.zeros((2, 2, 1, 1)))
    run = read_run(open_recording(path), 0.1)
    assert [has_positions(*given) for given in (([run], [run]), ([run], []), ([], [run]))] == [False, True, True]


@pytest.mark.parametrize("n", [(1, 3), (3, 1)])
def test_one_run_of_a_side(n: tuple[int, int]) -> None:
    """Compare nothing where a side has a single run that is not the other's."""
    found = Distances(between(1.0, 1.0, 2.0, n), "cm", n, exact=True, alike=(n[0] == 1, n[1] == 1), same=False)
    for finding in (compare_outcomes(found, SETTINGS, applies=True), compare_spread(W1, found, SETTINGS, applies=True)):
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
        assert (finding.missing, finding.applies) == ("too large", applies)


def test_mean_distances_within_the_sides() -> None:
    """Average over pairs of different runs of each side, and over none of a single run."""
    matrix = np.array([[0.0, 1.0, 2.0, 9.0], [1.0, 0.0, 6.0, 9.0], [2.0, 6.0, 0.0, 9.0], [9.0, 9.0, 9.0, 0.0]])
    assert Distances(matrix, "cm", (3, 1), exact=True, alike=(False, True), same=False).within() == (3.0, None)
    assert Distances(matrix[:, ::-1][::-1], "cm", (2, 2), exact=True, alike=(False, False), same=False).within() == (
        9.0,
        1.0,
    )
