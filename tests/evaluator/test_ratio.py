"""Ratios of means, and what their intervals cover."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.statistics.jackknife import ratio_of_means

POSITIVE = st.lists(st.floats(0.1, 10.0), min_size=3, max_size=6)


@given(values=POSITIVE, base=POSITIVE, scale=st.floats(0.01, 100.0))
def test_ratio_scales(values: list[float], base: list[float], scale: float) -> None:
    """Scale with the values, and turn round with the sides."""
    found, scaled = ratio_of_means(values, base), ratio_of_means(np.array(values) * scale, base)
    turned = ratio_of_means(base, values)
    assert found.estimate == pytest.approx(np.mean(values) / np.mean(base))
    assert scaled.estimate == pytest.approx(scale * found.estimate)
    assert turned.estimate == pytest.approx(1 / found.estimate)
    if found.low is not None and found.high is not None and turned.low is not None:
        assert 0 <= found.low <= found.estimate <= found.high
        assert turned.low == pytest.approx(1 / found.high)


def test_small_spread_is_the_classical_interval() -> None:
    """Agree with Welch's interval of a difference where the spread is small."""
    from scipy import stats

    rng = np.random.default_rng(1)
    a, b = 3 + 0.001 * rng.standard_normal(5), 2 + 0.003 * rng.standard_normal(8)
    found = ratio_of_means(a, b)
    classical = stats.ttest_ind(np.log(a), np.log(b), equal_var=False).confidence_interval(0.95)
    assert found.low == pytest.approx(np.exp(classical.low), rel=1e-5)
    assert found.high == pytest.approx(np.exp(classical.high), rel=1e-5)


@pytest.mark.parametrize(("n_a", "n_b"), [(3, 3), (5, 10)])
def test_coverage(n_a: int, n_b: int) -> None:
    """Cover the ratio of the laws' means about as often as is claimed."""
    rng = np.random.default_rng(0)
    trials, hits = 1000, 0
    for _ in range(trials):
        found = ratio_of_means(rng.normal(10, 0.5, n_a), rng.normal(5, 1.0, n_b))
        assert found.low is not None
        assert found.high is not None
        hits += found.low <= 2 <= found.high
    assert 0.92 < hits / trials < 0.99


def test_no_interval_says_why() -> None:
    """Name what an interval lacks, and refuse what has no ratio."""
    few = ratio_of_means([1.0, 2.0], [1.0, 1.0, 1.0])
    assert (few.low, few.reason) == (None, "needs at least 3 runs a side, got 2")
    equal = ratio_of_means([0.3] * 3, [0.1] * 7)
    assert (equal.low, equal.reason) == (None, "no spread in the runs of either side")
    assert ratio_of_means([0.3] * 3, [0.3] * 7).estimate == 1.0
    for bad in ([], [0.0], [-1.0], [np.nan], [[1.0]]):
        with pytest.raises(ValueError, match=r"values"):
            ratio_of_means(bad, [1.0])
