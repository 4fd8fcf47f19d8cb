"""Intervals of rates and of any statistic of cases, McNemar's test, the interquartile mean, and what is visible."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from gpusimbench.evaluator.episodes.comparison import unpaired_interval
from gpusimbench.evaluator.statistics.cases import (
    in_proportion,
    interquartile_mean,
    interval_over_cases,
    least_shown,
    mcnemar,
    mean_interval,
    paired,
    rate_interval,
    rows_differ,
    standard_error,
    wilson,
)

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(("successes", "trials"), [(0, 5), (8, 10), (31, 64), (64, 64)])
def test_wilson(successes: int, trials: int) -> None:
    """Agree with the closed form of Wilson's interval."""
    z, rate = 1.959963984540054, successes / trials
    middle = (rate + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials**2))
    assert wilson(successes, trials) == pytest.approx((middle - half, middle + half), abs=1e-12)


def test_mcnemar() -> None:
    """Agree with the binomial sum over discordant pairs, and say nothing where there are none."""
    tail = sum(math.comb(10, k) for k in range(3)) / 2**10
    assert mcnemar(2, 8) == pytest.approx(2 * tail) == mcnemar(8, 2)
    assert mcnemar(0, 0) == 1.0 == mcnemar(4, 4)


def test_interquartile_mean() -> None:
    """Leave out a quarter at either end, of each row."""
    values = RNG.permutation(np.array([1e9, 5, 3, 4, 6, -1e9, 7, 2]))
    assert interquartile_mean(values) == pytest.approx(4.5)
    assert interquartile_mean(np.array([values, values + 1])) == pytest.approx([4.5, 5.5])


@pytest.mark.parametrize(("alike", "most"), [(False, 1.25), (True, 3.5)])
def test_episodes_of_one_environment(alike: bool, most: float) -> None:
    """Widen the interval where the episodes of an environment are alike, and hardly where they are independent."""
    n_env, per_env = 64, 8
    flags = RNG.random((n_env, 1 if alike else per_env)) < 0.5
    flags = np.broadcast_to(flags, (n_env, per_env))
    low, high = rate_interval(flags)
    narrow = wilson(int(flags.sum()), flags.size)
    assert low <= narrow[0] < narrow[1] <= high
    ratio = (high - low) / (narrow[1] - narrow[0])
    assert ratio <= most and (ratio > 2) == alike
    assert rate_interval(flags[:, :1]) == wilson(int(flags[:, 0].sum()), n_env)
    assert rate_interval(flags[:7]) == wilson(int(flags[:7].sum()), 7 * per_env)  # too few to resample


def test_coverage_of_rates() -> None:
    """Hold the rate as often as is said, nearly, though environments differ; Wilson's interval alone does not."""
    hits = []
    for _ in range(300):
        rates = RNG.beta(2, 2, size=16)  # correlation of two episodes of an environment: 1 / (2 + 2 + 1)
        flags = RNG.random((16, 8)) < rates[:, None]
        of_both = rate_interval(flags), wilson(int(flags.sum()), flags.size)
        hits.append([low <= 0.5 <= high for low, high in of_both])
    ours, wilsons = np.mean(hits, axis=0)
    assert ours > 0.9 and wilsons < 0.87


def test_interval_of_any_statistic() -> None:
    """Be the interval of the mean where the statistic is the mean; none for few cases."""
    values = RNG.normal(size=40)
    found = interval_over_cases(lambda drawn: values[drawn].mean(axis=1), 40)
    expected = mean_interval(values)
    assert found is not None and expected is not None
    assert found == pytest.approx(expected, abs=1e-12)  # the same draws
    assert interval_over_cases(lambda drawn: drawn[:, 0].astype(float), 7) is None


@pytest.mark.parametrize("n_env", [8, 16])
def test_coverage_of_means(n_env: int) -> None:
    """Hold the mean of few environments as often as is said: the percentiles of resampled sets do in 89 and 91 %."""
    hits = []
    for seed in range(600):
        values = RNG.normal(size=(2, n_env))
        of_one = mean_interval(values[0], seed=seed)
        apart = unpaired_interval(values[0], values[1])
        assert of_one is not None and apart is not None
        hits.append([low <= 0 <= high for low, high in (of_one, apart)])
    error = (0.95 * 0.05 / len(hits)) ** 0.5
    assert np.mean(hits, axis=0) == pytest.approx([0.95, 0.95], abs=3 * error)


def test_equal_values_have_no_error() -> None:
    """Have a standard error of zero where values are equal, though their mean rounds."""
    equal = np.full(12, 0.1)
    assert equal.std() > 0 and standard_error(equal) == 0
    assert paired(equal, np.zeros(12)).visible == 0


def test_what_is_shown_with_a_power() -> None:
    """Be shown by a test at the 5 % level as often as is said."""
    error, power = 0.3, 0.8
    least = least_shown(error, power)
    drawn = RNG.normal(least, error, size=20_000)
    assert np.mean(np.abs(drawn) > 1.959963984540054 * error) == pytest.approx(power, abs=0.015)


@pytest.mark.parametrize("cases", [4, 8, 64])
def test_what_few_cases_show_with_a_power(cases: int) -> None:
    """Be shown by a t-test as often as is said, of as many cases as its error is known from."""
    least = least_shown(1 / cases**0.5, 0.8, cases - 1)
    drawn = RNG.normal(least, size=(20_000, cases))
    assert np.mean(stats.ttest_1samp(drawn, 0, axis=1).pvalue < 0.05) == pytest.approx(0.8, abs=0.025)


def test_rows_that_differ() -> None:
    """Tell environments that differ from those that do not, whatever episodes of one number have in common."""
    n_env, per_env = 12, 6
    columns = 5 * RNG.normal(size=per_env)
    alike = [rows_differ(RNG.normal(size=(n_env, per_env)) + columns, permutations=99) for _ in range(100)]
    assert np.mean(np.array(alike) <= 0.1) < 0.2
    apart = RNG.normal(size=(n_env, per_env)) + columns + 2 * RNG.normal(size=(n_env, 1))
    assert rows_differ(apart) < 0.01 and rows_differ(apart.T) < 0.01
    assert rows_differ(np.full((n_env, per_env), 0.1)) == 1.0


def test_the_largest_value_is_one_whatever_its_sign() -> None:
    """Keep the signs and the proportions of values, and leave zeros alone."""
    assert in_proportion(np.array([-4.0, -2.0])).tolist() == [-1.0, -0.5]
    assert in_proportion(np.array([1.0, -4.0])).tolist() == [0.25, -1.0]
    assert in_proportion(np.zeros(2)).tolist() == [0.0, 0.0]
