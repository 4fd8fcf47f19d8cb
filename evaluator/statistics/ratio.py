"""Ratio of two means over runs, with an interval: what one configuration costs in terms of another."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.statistics.jackknife import CONFIDENCE, Interval

MIN_RUNS = 3
"""Of either side, for an interval."""

METHOD = "delete-one-run jackknife of the log of each mean, 95 % by Student t with Welch's degrees of freedom"


def ratio_of_means(values: npt.ArrayLike, base: npt.ArrayLike) -> Interval:
    """Mean of some runs over the mean of other runs, with a 95 % interval.

    The two sides are independent samples. On the log scale a ratio is a difference, whose interval cannot reach zero:

        se_side^2 = (R - 1)/R * sum_r (log of the mean without r - their mean)^2
        interval: exp(log ratio -+ t(nu) * sqrt(se_a^2 + se_b^2)),   nu by Welch (1947) and Satterthwaite (1946)

    Args:
        values, base: one positive value per run, of one unit, shape [n_run]; the sides may differ in n_run.

    Returns:
        the ratio and its interval; without interval where a side has fewer than three runs, or where no run differs.

    Raises:
        ValueError: a side without values, not one axis, or values that are not finite and positive.
    """
    sides = [_side(one) for one in (values, base)]
    estimate = mean_of(sides[0]) / mean_of(sides[1])
    fewest = min(len(side) for side in sides)
    if fewest < MIN_RUNS:
        return Interval(estimate, None, None, None, METHOD, f"needs at least {MIN_RUNS} runs a side, got {fewest}")
    squares = [_squared_error(side) for side in sides]
    total = sum(squares)
    if total == 0:
        # an interval of width zero would claim that rare differences are excluded
        return Interval(estimate, None, None, None, METHOD, "no spread in the runs of either side")
    from scipy.special import stdtrit  # what scipy.stats.t.ppf calls, without a second of imports

    freedom = total**2 / sum(square**2 / (len(side) - 1) for square, side in zip(squares, sides, strict=True))
    error = math.sqrt(total)
    reach = float(stdtrit(freedom, 0.5 + CONFIDENCE / 2.0)) * error
    return Interval(estimate, estimate * math.exp(-reach), estimate * math.exp(reach), estimate * error, METHOD)


def _side(values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    side = np.asarray(values, dtype=np.float64)
    if side.ndim != 1 or len(side) == 0:
        raise ValueError(f"values must have shape [n_run], got {list(side.shape)}")
    if not (np.isfinite(side).all() and (side > 0).all()):
        raise ValueError("a ratio needs finite values above zero")
    return side


def mean_of(values: npt.NDArray[np.float64]) -> float:
    """Mean of values [n], n > 0, measured from the first one: equal values have their very value for a mean."""
    return float(values[0] + (values - values[0]).mean())


def _squared_error(side: npt.NDArray[np.float64]) -> float:
    n_run, offset = len(side), side - side[0]
    if not offset.any():  # logarithms of sums round
        return 0.0
    without = np.log(side[0] + (offset.sum() - offset) / (n_run - 1))
    return float((n_run - 1) / n_run * ((without - without.mean()) ** 2).sum())
