"""Numbers of episodes: intervals and tests of rates, the interquartile mean, and whether environments are alike."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.statistics.cases import mean_interval

_ROUNDING = 1e-9  # sums of the same numbers in another order


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """95 % interval of a probability, from independent trials (Wilson 1927)."""
    from scipy import stats

    found = stats.binomtest(successes, trials).proportion_ci(confidence_level=0.95, method="wilson")
    return float(found.low), float(found.high)


def rate_interval(flags: npt.NDArray[np.bool_ | np.float64], *, seed: int = 0) -> tuple[float, float]:
    """95 % interval of a rate, from flags [env, episode] whose environments are independent.

    A share between 0 and 1 stands for repeats of one episode: it counts as one, and the interval holds those of both
    whole numbers of successes beside the sum.

    Wilson's interval takes episodes to be independent. Where several are of one environment, it is widened to hold the
    interval that resampling environments gives (for fewer than 8 environments there is none).
    """
    total = float(flags.sum())
    low, _ = wilson(math.floor(total + _ROUNDING), flags.size)
    _, high = wilson(math.ceil(total - _ROUNDING), flags.size)
    by_env = mean_interval(flags.mean(axis=1), seed=seed) if flags.shape[1] > 1 else None
    return (min(low, by_env[0]), max(high, by_env[1])) if by_env else (low, high)


def mcnemar(only_first: int, only_second: int) -> float:
    """Two-sided p-value that two rates on the same cases are one, from the cases in which they differ (McNemar 1947),
    by the exact binomial test; 1 where there are none."""
    from scipy import stats

    differing = only_first + only_second
    return float(stats.binomtest(only_first, differing, 0.5).pvalue) if differing else 1.0


def rows_differ(values: npt.NDArray[np.float64], *, permutations: int = 999, seed: int = 0) -> float:
    """p-value that the rows of a table are alike: that their means spread as far if each column's entries are shuffled.

    values  [row, column]; what columns have in common stays, such as episodes of one number among environments
    """
    observed = values.mean(axis=1).var()
    rng = np.random.default_rng(seed)
    reached = sum(
        bool(rng.permuted(values, axis=0).mean(axis=1).var() >= observed * (1 - _ROUNDING)) for _ in range(permutations)
    )
    return (1 + reached) / (1 + permutations)


def interquartile_mean(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Mean along the last axis without the lowest and the highest quarter (IQM of rliable, Agarwal et al. 2021)."""
    from scipy import stats

    return np.asarray(stats.trim_mean(values, 0.25, axis=-1), dtype=np.float64)
