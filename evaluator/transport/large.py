"""W1 between two large planar point sets, as bounds that are proved rather than estimated, in memory of order n."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.transport.points import planar_array

METHOD = "multiscale auction"
SAME_POINTS = "same points"

_UNIT = 2.0**-53
_ROUNDINGS = 64  # in a value of the dual, of quantities up to its size; some twenty are counted
_WITHIN = 0.999  # of the tolerance: the bounds are widened for rounding afterwards
_FAR = "coordinates are too large: their distances overflow float64"

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Certified:
    """Bounds on W1: low <= W1 <= high, in the unit of the points.

    low      value of a feasible dual, less what rounding can have added
    high     mean distance of a one-to-one assignment, plus what rounding can have taken
    method   how they were obtained
    shared   points that both sets have at the same place, and that stay there
    bids     bids of the auction
    """

    low: float
    high: float
    method: str
    shared: int
    bids: int


def certified_wasserstein1(
    a: npt.ArrayLike, b: npt.ArrayLike, *, relative: float = 0.01, max_work: int | None = None
) -> Certified:
    """Bounds on W1 between two equally sized planar point sets under the Euclidean distance.

        W1(a, b) = min over one-to-one assignments s of  (1/n) * sum_i |a_i - b_s(i)|

    Below, Kantorovich's dual: W1 >= (1/n) * (sum_i u_i - sum_j p_j) where u_i - p_j <= |a_i - b_j| for all i, j. Above,
    any assignment. Both come from an auction. Points at the same place in both sets stay there: under a metric, that
    loses nothing. The same sets give the same bits, on one thread.

    Args:
        a, b: points [any length unit], shape [n, 2].
        relative: ends when high - low is at most this part of high; 0 asks for all that float64 can give.
        max_work: bids at most, None for no limit; where they run out the bounds hold as well, but are further apart.

    Raises:
        ValueError: a set is empty, not of shape [n, 2] or not finite; the counts differ; the distances overflow; a
            tolerance or limit is negative.
    """
    a, b = planar_array(a, "a", ndim=2), planar_array(b, "b", ndim=2)
    if len(a) != len(b):
        raise ValueError(f"sets of different size: a has {len(a)} points, b has {len(b)}")
    if not relative >= 0.0:
        raise ValueError(f"relative must not be negative, got {relative}")
    if max_work is not None and max_work < 0:
        raise ValueError(f"max_work must not be negative, got {max_work}")
    n = len(a)
    points, only_a, only_b = _without_shared(a, b)
    m = int(only_a.sum())
    if m == 0:
        return Certified(0.0, 0.0, SAME_POINTS, n, 0)
    points, exponent = _scaled(points)

    from gpusimbench.evaluator.transport.multiscale import solve

    in_a, in_b = only_a > 0, only_b > 0

    def excess(dual: float, primal: float) -> float:
        allowed = _WITHIN * relative * primal
        return (primal - dual) / allowed if allowed > 0.0 else math.inf

    solution = solve(
        points[in_a], only_a[in_a], points[in_b], only_b[in_b], extent=float(np.ptp(points, axis=0).max()),
        enough=excess, limit=sys.maxsize if max_work is None else max_work,
    )  # fmt: skip
    size = 4.0 + float(np.abs(solution.values).max()) + float(np.abs(solution.prices).max())
    low = max(0.0, (solution.dual() - m * size * _ROUNDINGS * _UNIT) / n)
    high = solution.primal() / n * (1.0 + _ROUNDINGS * _UNIT)
    return Certified(
        _unscaled(low, exponent, -math.inf), _unscaled(high, exponent, math.inf), METHOD, n - m, solution.bids
    )


def _without_shared(a: Floats, b: Floats) -> tuple[Floats, Counts, Counts]:
    """The places where one set has more points than the other [k, 2], and how many more a and b have, shapes [k]."""
    points, number = np.unique(np.concatenate([a, b]), axis=0, return_inverse=True)
    number = number.reshape(-1)
    excess = np.bincount(number[: len(a)], minlength=len(points)) - np.bincount(number[len(a) :], minlength=len(points))
    points, excess = points[excess != 0], excess[excess != 0]
    return points, np.maximum(excess, 0), np.maximum(-excess, 0)


def _scaled(points: Floats) -> tuple[Floats, int]:
    """The points by a power of two that makes their extent 1/2 to 1, and the exponent that undoes it."""
    with np.errstate(over="ignore"):
        extent = float(np.ptp(points, axis=0).max())
    if extent == math.inf:
        raise ValueError(_FAR)
    exponent = math.frexp(extent)[1]
    return np.ldexp(points, -exponent), exponent


def _unscaled(value: float, exponent: int, towards: float) -> float:
    """value * 2^exponent, rounded towards where it still is a bound, and not below 0."""
    try:
        bound = math.nextafter(math.ldexp(value, exponent), towards)
    except OverflowError:
        raise ValueError(_FAR) from None
    return max(0.0, bound)
