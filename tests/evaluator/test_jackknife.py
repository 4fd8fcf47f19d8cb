"""Jackknife intervals, and those of ratios of means."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.statistics.jackknife import jackknife_mean, jackknife_pair_mean, ratio_of_means


def distances(points: np.ndarray) -> np.ndarray:
    """Distances between points on a line, shape [n] -> [n, n]."""
    return np.abs(points[:, None] - points)


def test_mean_is_the_student_interval() -> None:
    """Agree with the classical interval for a mean."""
    values = np.random.default_rng(0).normal(5.0, 1.0, size=10)
    result = jackknife_mean(values)
    error = values.std(ddof=1) / np.sqrt(10)
    assert result.estimate == pytest.approx(values.mean())
    assert result.standard_error == pytest.approx(error)
    assert known(result.ci95) == pytest.approx(stats.t.interval(0.95, 9, loc=values.mean(), scale=error))


def test_mean_clips_at_zero() -> None:
    """Clip the lower end at zero, and say so."""
    result = jackknife_mean([0.0, 0.1, 4.0])
    assert result.ci95
    assert result.ci95[0] == 0.0
    assert result.method.endswith("lower end clipped at 0")


def test_equal_values_have_no_width() -> None:
    """Give an interval of no width for equal values, without rounding."""
    result = jackknife_mean([4.21] * 7)
    assert (result.estimate, result.ci95, result.standard_error) == (4.21, (4.21, 4.21), 0.0)


def test_one_run_has_no_interval() -> None:
    """Give a reason in place of an interval for a single run."""
    result = jackknife_mean([1.5])
    assert (result.estimate, result.ci95) == (1.5, Missing("needs at least two runs, got 1"))


def test_pair_mean_by_definition() -> None:
    """Agree with leaving out one run at a time by hand."""
    matrix = distances(np.random.default_rng(1).normal(size=6))
    result = jackknife_pair_mean(matrix)
    without = []
    for r in range(6):
        rest = np.delete(np.delete(matrix, r, 0), r, 1)
        without.append(rest[np.triu_indices(5, 1)].mean())
    expected = np.sqrt(5 / 6 * np.sum((without - np.mean(without)) ** 2))
    assert result.estimate == pytest.approx(matrix[np.triu_indices(6, 1)].mean())
    assert result.standard_error == pytest.approx(expected)


def test_pair_mean_of_equal_distances() -> None:
    """Give an interval of no width where all pairs are equally far apart."""
    result = jackknife_pair_mean(2.15 * (1 - np.eye(10)))
    assert (result.estimate, result.ci95) == (2.15, (2.15, 2.15))


def test_pair_mean_clips_at_zero() -> None:
    """Keep the lower end of a distance at zero."""
    result = jackknife_pair_mean(distances(np.array([0.0, 0.0, 0.0, 1.0])))
    assert result.ci95
    assert result.ci95[0] == 0.0
    assert "clipped" in result.method


def test_two_runs_have_no_interval() -> None:
    """Give a reason in place of an interval for one pair."""
    result = jackknife_pair_mean([[0.0, 3.0], [3.0, 0.0]])
    assert (result.estimate, result.ci95) == (3.0, Missing("needs at least three runs, got 2"))


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.zeros((2, 3)), "shape"),
        (np.zeros((1, 1)), "at least two runs"),
        (np.zeros((3, 2)), "must have shape"),
        ([[0.0, 1.0], [2.0, 0.0]], "symmetric"),
        ([[0.0, -1.0], [-1.0, 0.0]], "not negative"),
        ([[0.0, np.nan], [np.nan, 0.0]], "finite"),
    ],
)
def test_pair_mean_refuses(matrix, message: str) -> None:
    """Refuse what is no matrix of distances."""
    with pytest.raises(ValueError, match=message):
        jackknife_pair_mean(matrix)


@pytest.mark.parametrize("values", [[], [[1.0]], [1.0, np.nan]])
def test_mean_refuses(values: list) -> None:
    """Refuse values that have no mean."""
    with pytest.raises(ValueError):
        jackknife_mean(values)


POSITIVE = st.lists(st.floats(0.1, 10.0), min_size=3, max_size=6)


@given(values=POSITIVE, base=POSITIVE, scale=st.floats(0.01, 100.0))
def test_ratio_scales(values: list[float], base: list[float], scale: float) -> None:
    """Scale with the values, and turn round with the sides."""
    found, scaled = ratio_of_means(values, base), ratio_of_means(np.array(values) * scale, base)
    turned = ratio_of_means(base, values)
    assert found.estimate == pytest.approx(np.mean(values) / np.mean(base))
    assert scaled.estimate == pytest.approx(scale * found.estimate)
    assert turned.estimate == pytest.approx(1 / found.estimate)
    if found.ci95 and turned.ci95:
        low, high = found.ci95
        assert 0 <= low <= found.estimate <= high
        assert turned.ci95[0] == pytest.approx(1 / high)


def test_small_spread_is_the_classical_interval() -> None:
    """Agree with Welch's interval of a difference where the spread is small."""
    from scipy import stats

    rng = np.random.default_rng(1)
    a, b = 3 + 0.001 * rng.standard_normal(5), 2 + 0.003 * rng.standard_normal(8)
    found = ratio_of_means(a, b)
    classical = stats.ttest_ind(np.log(a), np.log(b), equal_var=False).confidence_interval(0.95)
    assert known(found.ci95) == pytest.approx(np.exp(classical), rel=1e-5)


@pytest.mark.parametrize(("n_a", "n_b"), [(3, 3), (5, 10)])
def test_coverage_of_ratios(n_a: int, n_b: int) -> None:
    """Cover the ratio of the laws' means about as often as is claimed."""
    rng = np.random.default_rng(0)
    trials, hits = 1000, 0
    for _ in range(trials):
        found = ratio_of_means(rng.normal(10, 0.5, n_a), rng.normal(5, 1.0, n_b))
        assert found.ci95
        hits += found.ci95[0] <= 2 <= found.ci95[1]
    assert 0.92 < hits / trials < 0.99


def test_no_interval_says_why() -> None:
    """Name what an interval lacks, and refuse what has no ratio."""
    few = ratio_of_means([1.0, 2.0], [1.0, 1.0, 1.0])
    assert few.ci95 == Missing("needs at least 3 runs a side, got 2")
    equal = ratio_of_means([0.3] * 3, [0.1] * 7)
    assert equal.ci95 == Missing("no spread in the runs of either side")
    assert ratio_of_means([0.3] * 3, [0.3] * 7).estimate == 1.0
    for bad in ([], [0.0], [-1.0], [np.nan], [[1.0]]):
        with pytest.raises(ValueError, match=r"values"):
            ratio_of_means(bad, [1.0])
