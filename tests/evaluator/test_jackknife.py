"""Jackknife intervals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from gpusimbench.evaluator.statistics.jackknife import jackknife_mean, jackknife_pair_mean


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
    assert (result.low, result.high) == pytest.approx(stats.t.interval(0.95, 9, loc=values.mean(), scale=error))


def test_mean_clips_at_zero() -> None:
    """Clip the lower end at zero, and say so."""
    result = jackknife_mean([0.0, 0.1, 4.0])
    assert result.low == 0.0
    assert result.method.endswith("lower end clipped at 0")


def test_equal_values_have_no_width() -> None:
    """Give an interval of no width for equal values, without rounding."""
    result = jackknife_mean([4.21] * 7)
    assert (result.estimate, result.low, result.high, result.standard_error) == (
        4.21,
        4.21,
        4.21,
        0.0,
    )


def test_one_run_has_no_interval() -> None:
    """Give a reason in place of an interval for a single run."""
    result = jackknife_mean([1.5])
    assert (result.estimate, result.low, result.high) == (1.5, None, None)
    assert result.reason == "needs at least two runs, got 1"


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
    assert (result.estimate, result.low, result.high) == (2.15, 2.15, 2.15)


def test_pair_mean_clips_at_zero() -> None:
    """Keep the lower end of a distance at zero."""
    result = jackknife_pair_mean(distances(np.array([0.0, 0.0, 0.0, 1.0])))
    assert result.low == 0.0
    assert "clipped" in result.method


def test_two_runs_have_no_interval() -> None:
    """Give a reason in place of an interval for one pair."""
    result = jackknife_pair_mean([[0.0, 3.0], [3.0, 0.0]])
    assert (result.estimate, result.low, result.high) == (3.0, None, None)
    assert result.reason == "needs at least three runs, got 2"


def test_coverage() -> None:
    """Cover the true pair mean about as often as promised; counting pairs as independent fails."""
    rng = np.random.default_rng(0)
    truth = 2.0 / np.sqrt(np.pi)  # E|x - x'| for standard normal x, x'
    n_trial, n_run = 600, 10
    covered = naive = 0
    for _ in range(n_trial):
        matrix = distances(rng.normal(size=n_run))
        result = jackknife_pair_mean(matrix)
        assert result.low is not None
        assert result.high is not None
        covered += result.low <= truth <= result.high
        pairs = matrix[np.triu_indices(n_run, 1)]
        reach = 2.015 * pairs.std(ddof=1) / np.sqrt(len(pairs))  # t(44), 95 %
        naive += abs(pairs.mean() - truth) <= reach
    assert 0.90 <= covered / n_trial <= 0.98
    assert naive / n_trial < 0.85


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
