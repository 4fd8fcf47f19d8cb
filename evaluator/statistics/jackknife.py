"""Delete-one-run jackknife: intervals that treat runs, not run pairs, as the independent unit; also of ratios."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing

CONFIDENCE = 0.95

MIN_RUNS_A_SIDE = 3
"""Runs of either side of a ratio, for an interval."""

_OF_RATIO = "delete-one-run jackknife of the log of each mean, 95 % by Student t with Welch's degrees of freedom"


@dataclass(frozen=True)
class Interval:
    """An estimate and its 95 % confidence interval, all in the unit of the values.

    estimate         mean over runs or run pairs
    ci95             low and high end of the interval, or why it cannot be computed
    standard_error   jackknife standard error; None where there is no interval
    method           how the interval was obtained
    """

    estimate: float
    ci95: tuple[float, float] | Missing
    standard_error: float | None
    method: str


def jackknife_mean(values: npt.ArrayLike) -> Interval:
    """Mean of nonnegative values over runs with a delete-one-run interval (Quenouille 1956, Tukey 1958).

        se^2 = (R - 1)/R * sum_r (mean without r - their mean)^2,   interval: mean -+ t(R - 1) * se

    which for a mean is the classical Student interval; its lower end is clipped at 0.

    Args:
        values: one value per run [any unit], shape [n_run].

    Returns:
        estimate and interval [same unit]; without interval for a single run.

    Raises:
        ValueError: no values, not one axis, or values that are not finite.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 1 or len(values) == 0:
        raise ValueError(f"values must have shape [n_run], got {list(values.shape)}")
    if not np.isfinite(values).all():
        raise ValueError("values are not finite")
    n_run = len(values)
    # Measured from the first value, so that equal values give exactly that mean and error zero.
    offset = values - values[0]
    estimate = float(values[0] + offset.mean())
    method = _method("runs")
    if n_run < 2:
        return Interval(estimate, Missing("needs at least two runs, got 1"), None, method)
    without = (offset.sum() - offset) / (n_run - 1)
    return _interval(estimate, without, method)


def jackknife_pair_mean(matrix: npt.ArrayLike) -> Interval:
    """Mean distance over run pairs r < r' with a delete-one-run interval.

    The pairs share runs and are dependent: an interval that counts them as independent is far too
    narrow. The mean over pairs is a U-statistic of degree two, whose jackknife is due to
    Arvesen (1969):

        se^2 = (R - 1)/R * sum_r (pair mean without run r - their mean)^2
        interval: pair mean -+ t(R - 1) * se, lower end clipped at 0 since these are distances

    Args:
        matrix: distances between runs [any unit], shape [n_run, n_run]; symmetric.

    Returns:
        estimate and interval [same unit]; without interval for fewer than three runs.

    Raises:
        ValueError: not a symmetric square matrix of finite distances, or fewer than two runs.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"matrix must have shape [n_run, n_run], got {list(matrix.shape)}")
    n_run = len(matrix)
    if n_run < 2:
        raise ValueError(f"a mean over run pairs needs at least two runs, got {n_run}")
    if not np.isfinite(matrix).all() or (matrix < 0.0).any():
        raise ValueError("distances must be finite and not negative")
    if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0.0):
        raise ValueError("matrix is not symmetric")
    offset = matrix - matrix[0, 1]
    np.fill_diagonal(offset, 0.0)
    by_run = offset.sum(axis=1)
    total = by_run.sum() / 2.0
    estimate = float(matrix[0, 1] + total / (n_run * (n_run - 1) / 2))
    method = _method("run pairs")
    if n_run < 3:
        return Interval(estimate, Missing("needs at least three runs, got 2"), None, method)
    without = (total - by_run) / ((n_run - 1) * (n_run - 2) / 2)
    return _interval(estimate, without, method)


def _method(unit: str) -> str:
    return f"delete-one-run jackknife over {unit}, 95 % by Student t(R-1), lower end clipped at 0"


def _interval(estimate: float, without: npt.NDArray[np.float64], method: str) -> Interval:
    """Interval from the delete-one estimates (up to a common offset), shape [n_run]."""
    from scipy.special import stdtrit  # what scipy.stats.t.ppf calls, without a second of imports

    n_run = len(without)
    deviation = without - without.mean()
    error = float(np.sqrt((n_run - 1) / n_run * (deviation**2).sum()))
    reach = float(stdtrit(n_run - 1, 0.5 + CONFIDENCE / 2.0)) * error
    return Interval(estimate, (max(estimate - reach, 0.0), estimate + reach), error, method)


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
    if fewest < MIN_RUNS_A_SIDE:
        few = Missing(f"needs at least {MIN_RUNS_A_SIDE} runs a side, got {fewest}")
        return Interval(estimate, few, None, _OF_RATIO)
    squares = [_squared_error(side) for side in sides]
    total = sum(squares)
    if total == 0:
        # an interval of width zero would claim that rare differences are excluded
        return Interval(estimate, Missing("no spread in the runs of either side"), None, _OF_RATIO)
    from scipy.special import stdtrit  # what scipy.stats.t.ppf calls, without a second of imports

    freedom = total**2 / sum(square**2 / (len(side) - 1) for square, side in zip(squares, sides, strict=True))
    error = math.sqrt(total)
    reach = float(stdtrit(freedom, 0.5 + CONFIDENCE / 2.0)) * error
    ends = (estimate * math.exp(-reach), estimate * math.exp(reach))
    return Interval(estimate, ends, estimate * error, _OF_RATIO)


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
