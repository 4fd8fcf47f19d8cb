"""Means, rates and differences over cases, such as tosses and episodes: intervals, and tests case by case."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

DRAWS = 2000
"""Resampled sets of cases behind an interval."""

PERMUTATIONS = 9999
"""Of signs, drawn at random."""

APART = 1e6
"""Is added to the statistics of permutation tests of SciPy, of values `in_proportion`: it counts an arrangement if its
statistic is the observed one but for 2e-14 of that, which is less than rounding where the observed one is small."""

_ROUNDING = 1e-9  # sums of the same numbers in another order
_AT_ONCE = 1_000_000  # cases that are drawn, all draws together

FEWEST = 8
"""Cases for an interval."""


@dataclass(frozen=True)
class Paired:
    """A comparison over cases that both were judged on.

    mean     of the differences a - b, in the unit of the values
    ci95     by resampling cases; None for fewer than FEWEST
    p_value  that signs drawn at random give a mean as far from zero (sign-flip permutation test, two-sided)
    cases    that were compared
    visible  smallest mean difference that so many cases show with 95 % probability at the 5 % level, from the spread
             of the differences: (t_0.975 + t_0.95) SD / sqrt(cases), for normal means; 0 where there is no spread, None
             for one case, which has none to tell
    """

    mean: float
    ci95: tuple[float, float] | None
    p_value: float
    cases: int
    visible: float | None


def in_proportion(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Values in units of the largest, of either sign.

    Of values such as returns, many arrangements have one sum, but for rounding. With APART, permutation tests take
    sums for one that are equal to 2e-8 of the largest value; p-values would be too small.
    """
    largest = np.abs(values).max(initial=0.0)
    return values / largest if largest else values


def mean_interval(values: npt.ArrayLike, *, seed: int = 0) -> tuple[float, float] | None:
    """95 % interval of a mean over cases, by resampling cases; see ends_of.

    values  one a case, shape [case]

    None for fewer than FEWEST cases. ValueError where the shape is another.
    """
    found = np.asarray(values, dtype=np.float64)
    if found.ndim != 1:
        raise ValueError(f"values have the shape [case], not {found.shape}")
    return interval_over_cases(lambda drawn: found[drawn].mean(axis=1), len(found), seed=seed)


def interval_over_cases(
    statistic: Callable[[npt.NDArray[np.int64]], npt.NDArray[np.float64]], cases: int, *, seed: int = 0
) -> tuple[float, float] | None:
    """95 % interval of any statistic of cases, by resampling cases; see ends_of.

    statistic  takes the numbers of drawn cases, shape [draw, case], with repetitions, and returns numbers [draw]

    None for fewer than FEWEST cases.
    """
    if cases < FEWEST:
        return None
    return ends_of(resampled(statistic, cases, seed=seed), cases - 1, math.sqrt(cases / (cases - 1)))


def resampled(
    statistic: Callable[[npt.NDArray[np.int64]], npt.NDArray[np.float64]], cases: int, *, seed: int
) -> npt.NDArray[np.float64]:
    """A statistic, as of interval_over_cases, of each resampled set of cases, shape [draw]."""
    rng = np.random.default_rng(seed)
    at_once = max(1, _AT_ONCE // cases)
    sizes = [min(at_once, DRAWS - first) for first in range(0, DRAWS, at_once)]
    return np.concatenate([statistic(rng.integers(cases, size=(size, cases))) for size in sizes])


def ends_of(drawn: npt.NDArray[np.float64], freedom: float, wider: float) -> tuple[float, float]:
    """95 % interval from the statistic of resampled sets of cases: the expanded percentile interval (Hesterberg 2015).

    Resampling n cases spreads their mean by s sqrt(n - 1) / n instead of s / sqrt(n), and s is not known exactly: of
    the intervals from the 2.5th to the 97.5th percentile, 91 % hold the mean of a normal law with n = 16. The
    percentiles that are taken here are further apart, so that the interval is as wide as Student's where the statistic
    is a mean of normal values:

        level = Phi(-t_0.975(freedom) wider)

    drawn    the statistic of each set, shape [draw]
    freedom  degrees of freedom of the standard error
    wider    standard error over the standard deviation of resampled sets
    """
    from scipy.special import ndtr, stdtrit

    level = float(ndtr(-stdtrit(freedom, 0.975) * wider))
    low, high = np.quantile(drawn, (level, 1 - level))
    return float(low), float(high)


def least_shown(error: float, power: float, freedom: float = math.inf) -> float:
    """The smallest difference that a two-sided test at the 5 % level shows with a probability `power`.

    For normal means: (t_0.975 + t_power) times the standard error of the difference, in its unit. With the normal law's
    quantiles instead of Student's, a difference that is told to be seen in 80 % of comparisons of 8 pairs is seen in
    67 %.

    freedom  degrees of freedom of the error; infinite where it is known
    """
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975) + stdtrit(freedom, power)) * error


def paired(a: npt.ArrayLike, b: npt.ArrayLike, *, seed: int = 0) -> Paired:
    """Compare values of the same cases, shape [case] each.

    Under the hypothesis that a and b are exchangeable in each case, every difference has either sign with the same
    probability (Fisher's permutation test for paired samples).

    ValueError where there are no cases, not as many of both, or values that are not finite.
    """
    from scipy import stats

    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if first.shape != second.shape or first.ndim != 1 or not first.size:
        raise ValueError(f"values of the same cases have one shape [case], not {first.shape} and {second.shape}")
    difference = first - second
    if not np.isfinite(difference).all():
        raise ValueError("values are not all finite")
    if len(difference) == 1:
        return Paired(float(difference[0]), None, 1.0, 1, None)  # with either sign it is as far from zero
    if not difference.any():
        return Paired(0.0, mean_interval(difference, seed=seed), 1.0, len(difference), 0.0)
    tested = stats.permutation_test(
        (in_proportion(difference),),
        lambda values, axis: APART + values.mean(axis=axis),
        permutation_type="samples",
        n_resamples=PERMUTATIONS,
        vectorized=True,
        rng=np.random.default_rng(seed),
    )
    error = standard_error(difference)
    assert error is not None
    return Paired(
        float(difference.mean()),
        mean_interval(difference, seed=seed),
        float(tested.pvalue),
        len(difference),
        least_shown(error, 0.95, len(difference) - 1),
    )


def standard_error(cases: npt.NDArray[np.float64]) -> float | None:
    """The standard error of the mean of independent cases, shape [case]; 0 if all are equal, None of fewer than two."""
    # about the first case, since the mean of equal numbers rounds
    return float((cases - cases[0]).std(ddof=1) / np.sqrt(len(cases))) if len(cases) > 1 else None


def variation(cases: npt.NDArray[np.float64]) -> float:
    """The coefficient of variation: standard deviation over the size of the mean; infinite where cases with a mean of
    zero spread, and 0 where they do not spread, or are fewer than two."""
    spread, middle = (
        float((cases - cases[0]).std(ddof=1)) if len(cases) > 1 else 0.0,
        abs(float(cases.mean())) if len(cases) else 0.0,
    )
    return 0.0 if not spread else spread / middle if middle else math.inf


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a probability, from independent trials (Wilson 1927)."""
    from scipy import stats

    found = stats.binomtest(successes, trials).proportion_ci(confidence_level=0.95, method="wilson")
    return float(found.low), float(found.high)


def rate_interval(flags: npt.NDArray[np.bool_ | np.float64]) -> tuple[float, float]:
    """95 % interval of a rate, from flags [env, episode] whose environments are independent.

    A share between 0 and 1 stands for repeats of one episode: it counts as one, and the interval holds those of both
    whole numbers of successes beside the sum.

    Wilson's interval takes episodes to be independent. Where several are of one environment, it is widened to hold the
    interval that resampling environments gives (for fewer than 8 environments there is none).
    """
    total = float(flags.sum())
    low, _ = wilson(math.floor(total + _ROUNDING), flags.size)
    _, high = wilson(math.ceil(total - _ROUNDING), flags.size)
    by_env = mean_interval(flags.mean(axis=1)) if flags.shape[1] > 1 else None
    return (min(low, by_env[0]), max(high, by_env[1])) if by_env else (low, high)


def mcnemar(only_first: int, only_second: int) -> float:
    """Two-sided p-value that two rates on the same cases are one, from the cases in which they differ (McNemar 1947),
    by the exact binomial test; 1 where there are none."""
    from scipy import stats

    differing = only_first + only_second
    return float(stats.binomtest(only_first, differing, 0.5).pvalue) if differing else 1.0


def rows_differ(values: npt.NDArray[np.float64], *, permutations: int = 999) -> float:
    """p-value that the rows of a table are alike: that their means spread as far if each column's entries are shuffled.

    values  [row, column]; what columns have in common stays, such as episodes of one number among environments
    """
    observed = values.mean(axis=1).var()
    rng = np.random.default_rng(0)
    reached = sum(
        bool(rng.permuted(values, axis=0).mean(axis=1).var() >= observed * (1 - _ROUNDING)) for _ in range(permutations)
    )
    return (1 + reached) / (1 + permutations)


def interquartile_mean(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Mean along the last axis without the lowest and the highest quarter (IQM of rliable, Agarwal et al. 2021)."""
    from scipy import stats

    return np.asarray(stats.trim_mean(values, 0.25, axis=-1), dtype=np.float64)
