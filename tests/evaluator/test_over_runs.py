"""One value from the values of runs."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.results.aggregate import mean_over_runs


@given(st.floats(0, 1e9), st.integers(1, 12))
def test_equal_values_have_no_spread(value: float, runs: int) -> None:
    """Give equal values themselves as their mean, and no deviation, however sums of them would round."""
    metric = mean_over_runs("w1", "cm", "lower", [value] * runs, method="", extra={})
    assert metric.value == value
    assert metric.sd == (0.0 if runs > 1 else None)
    assert metric.ci95 is None


def test_values_with_spread() -> None:
    """Give mean, standard deviation of a sample, and an interval about it."""
    metric = mean_over_runs("w1", "cm", "lower", [1.0, 2.0, 3.0, 6.0], method="", extra={})
    assert metric.value == 3.0
    assert metric.sd is not None
    assert abs(metric.sd**2 - 14 / 3) < 1e-12
    assert metric.ci95 is not None
    assert metric.ci95[0] < 3.0 < metric.ci95[1]
