"""Findings of gsb-compare as people read them."""

from __future__ import annotations

from typing import Any

import pytest

from gpusimbench.evaluator.compare.compare import Result
from gpusimbench.evaluator.compare.finding import Change, Finding, Settings
from gpusimbench.evaluator.compare.words import TITLES, cells, verdict
from gpusimbench.evaluator.results.metric import Axis, Direction

RESULT = Result((), (), (), Settings(gates=frozenset({Axis.THROUGHPUT, Axis.MEMORY})), 0, 0, ())
SAME = Result((), (), (), Settings(gates=frozenset({Axis.THROUGHPUT}), expect_same=True), 0, 0, ())


def finding(change: Change, axis: Axis = Axis.THROUGHPUT, **more: Any) -> Finding:
    """A finding of an axis with a gate."""
    return Finding(axis, "name", "title", change, Direction.HIGHER, **more)


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (finding(Change.SAME), "same"),
        (finding(Change.REGRESSION, p_adjusted=0.01), "REGRESSION"),
        (finding(Change.REGRESSION, Axis.BITS), "regression (not gated)"),
        (finding(Change.CHANGED, Axis.BITS), "changed (not gated)"),
        (finding(Change.IMPROVEMENT, Axis.BITS), "improvement"),
        (finding(Change.UNCLEAR, p_adjusted=0.4), "~"),
        (finding(Change.UNCLEAR), "~ (too few runs)"),
        (finding(Change.UNCLEAR, bounded=True), "~"),
        (finding(Change.UNCLEAR, left_open=(Change.REGRESSION,)), "undecided (too few runs)"),
        (finding(Change.UNCLEAR, left_open=(Change.REGRESSION,), p_adjusted=0.4), "undecided"),
        (finding(Change.UNCLEAR, left_open=(Change.REGRESSION,), bounded=True), "undecided"),
        (finding(Change.UNCLEAR, left_open=(Change.IMPROVEMENT,)), "~ (too few runs)"),
        (finding(Change.NOT_COMPARED, why_not="no states"), "undecided (too few runs)"),
        (finding(Change.NOT_COMPARED, why_not="no states", applies=False), "not compared"),
        (finding(Change.WITHIN, p_adjusted=0.4), "~ within 5 %"),
        (finding(Change.SMALL, unit="cm"), "differs, below 0.01 cm"),
        (finding(Change.NEAR, bounded=True), "differs, perhaps below 5 %"),
        (finding(Change.SMALL, Axis.MEMORY, unit="B", base=1e5, head=2e5), "differs, below 1 MB"),
        (finding(Change.SMALL, Axis.MEMORY, unit="B", base=1e9, head=1.01e9), "differs, below 5 %"),
        (
            finding(Change.NEAR, Axis.MEMORY, unit="B", base=1e6, head=1.01e6, ci95=(0.9, 1.2)),
            "differs, perhaps below 1 MB",
        ),
        (finding(Change.SMALL, Axis.MEMORY, unit="B"), "differs, below 5 %"),
    ],
)  # fmt: skip
def test_verdicts(found: Finding, said: str) -> None:
    """Shout where a gate fails, say that a gate is open, that runs are few, or that an axis does not decide."""
    assert verdict(found, RESULT) == said


@pytest.mark.parametrize(
    ("change", "said"),
    [(Change.SMALL, "DIFFERS, BELOW 5 %"), (Change.IMPROVEMENT, "IMPROVEMENT"), (Change.SAME, "same")],
)
def test_verdicts_of_what_is_to_be_one(change: Change, said: str) -> None:
    """Shout at every difference where both sides are said to be of one thing, whatever its axis."""
    assert verdict(finding(change, Axis.BUILD), SAME) == said


@pytest.mark.parametrize(
    ("found", "row"),
    [
        (
            finding(
                Change.REGRESSION, unit="B", base=2e6, head=3e9, ratio=1500.0, ci95=(0.0005, 999.4), p_adjusted=0.0123
            ),
            ("title", "2.000 MB", "3.000 GB", "1.5e+03", "[0.0005, 999.400]", "0.012", "REGRESSION"),
        ),
        (
            finding(Change.SAME, unit="s", base=1.23456, head=1.5, ratio=1.2345),
            ("title [s]", "1.23", "1.5", "1.234", "-", "-", "same"),
        ),
        (finding(Change.SAME, said=("3 of 3", "2 of 3")), ("title", "3 of 3", "2 of 3", "-", "-", "-", "same")),
        (finding(Change.SAME, base=1.0), ("title", "1", "-", "-", "-", "-", "same")),
    ],
)
def test_rows(found: Finding, row: tuple[str, ...]) -> None:
    """Show amounts in their unit, factors with three decimals, and a dash for what there is not."""
    assert len(row) == len(TITLES)
    assert cells(found, RESULT) == row
