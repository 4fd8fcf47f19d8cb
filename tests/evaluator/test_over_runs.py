"""One value from the values of runs."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.results.group_runs import mean_of, median_of


@given(st.floats(0, 1e9), st.integers(1, 12))
def test_equal_values_have_no_spread(value: float, runs: int) -> None:
    """Give equal values themselves as their mean, and no deviation, however sums of them would round."""
    found = mean_of([value] * runs)
    assert found.value == value
    assert found.sd == (0.0 if runs > 1 else None)
    assert not found.ci95


def test_values_with_spread() -> None:
    """Give mean, standard deviation of a sample, and an interval about it."""
    found = mean_of([1.0, 2.0, 3.0, 6.0])
    assert found.value == 3.0
    assert abs(found.sd**2 - 14 / 3) < 1e-12
    assert found.ci95
    assert found.ci95[0] < 3.0 < found.ci95[1]


def test_a_median() -> None:
    """Give the middle value, whatever the first run took, and claim no interval."""
    found = median_of([90.0, 2.0, 3.0])
    assert (found.value, found.sd, found.ci95) == (3.0, None, None)
