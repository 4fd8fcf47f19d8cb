"""W1 between two large planar point sets, as bounds that are proved rather than estimated, in memory of order n.

Auctions assign ever more of the points, each beginning at the prices of the last.
Prices are a function over the plane that hardly depends on how many points it is drawn from. So the long way of prices
is gone with few points, and all points only settle what is left. After each auction prices are replaced by

    p_j = max_i (u_i - |x_i - y_j|),   u_i = min_j (|x_i - y_j| + p_j),

which are feasible with the same u and nowhere higher. That takes most of the error out of the lower bound, and the
noise of bidding out of the prices, without which the next auction would search and bid several times as much.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.transport.auction import Counts, hold_auction, least_values
from gpusimbench.evaluator.transport.kd_tree import Floats, Tree, build, set_planes
from gpusimbench.evaluator.transport.points import planar_array

COARSEST = 600
"""Points of the coarsest level, at least, where there are as many."""

RATIO = 4
"""Points of a level to those of the one before."""

FINER = 5.0
"""The eps of a phase to that of the next."""

_FIRST_EPS = 0.05  # of the extent of a or b, the larger: prices of good duals differ by no more than that
_LAST_EPS = 0.3  # of the spacing of a level's points: below it prices follow the sample rather than the law
_LEAST_EPS = 2.0**-44  # of the extent: prices are float64
_SLACK = 0.1  # of eps: larger ones make searches cheaper and bids more
_LOSS = 0.01  # of eps, that a transform may miss: where many places are equally good, exact ones visit them all
_AHEAD = 0.25  # of the tolerance: a level that is so close already leaves nothing to the next
_AIM = 0.7  # of the eps at which the gap should meet the tolerance, if both shrink alike

METHOD = "multiscale auction"
SAME_POINTS = "same points"
_UNIT = 2.0**-53
_ROUNDINGS = 64  # in a value of the dual, of quantities up to its size; some twenty are counted
_WITHIN = 0.999  # of the tolerance: the bounds are widened for rounding afterwards
_FAR = "coordinates are too large: their distances overflow float64"


@dataclass(frozen=True)
class Cloud:
    """Distinct points in the order of their tree, with how often each is there, shape [n]."""

    tree: Tree
    counts: Counts

    @property
    def points(self) -> Floats:
        """Shape [n, 2]."""
        return self.tree.points


@dataclass(frozen=True)
class Solution:
    """A feasible dual and an assignment, for a and b as clouds.

    values     u of each point of a; u_i - p_j <= |x_i - y_j| up to rounding, shape [n_a]
    prices     p of each point of b, shape [n_b]
    origin     the point of a that each unit of mass comes from, shape [m]
    place      the point of b that it goes to, shape [m]
    bids       bids made
    """

    a: Cloud
    b: Cloud
    values: Floats
    prices: Floats
    origin: npt.NDArray[np.int32]
    place: npt.NDArray[np.int32]
    bids: int

    def dual(self) -> float:
        """Sum of u over a less that of p over b."""
        return math.fsum(np.concatenate([self.a.counts * self.values, -(self.b.counts * self.prices)]))

    def primal(self) -> float:
        """Sum of the distances of the assignment."""
        return math.fsum(np.hypot(*(self.a.points[self.origin] - self.b.points[self.place]).T))


def solve(
    a: Floats, counts_a: Counts, b: Floats, counts_b: Counts, *, extent: float,
    enough: Callable[[float, float], float], limit: int,
) -> Solution:  # fmt: skip
    """A dual and an assignment between distinct points a [n_a, 2] and b [n_b, 2], counts of the same sum m.

    Args:
        a, counts_a, b, counts_b: the points, and how often each is there.
        extent: width or height of all points, the larger.
        enough: of the dual and the primal sum, how far their gap is above what is asked for: at most 1 ends it.
        limit: bids at most; what has no place then gets one in the order of the tree.
    """
    m = int(counts_a.sum())
    strides = [1]
    while m // (strides[-1] * RATIO) >= COARSEST:
        strides.append(strides[-1] * RATIO)
    whole = Cloud(*_treed(a, counts_a)), Cloud(*_treed(b, counts_b))
    wide = max(float(np.ptp(a, axis=0).max()), float(np.ptp(b, axis=0).max()), _LEAST_EPS * extent)
    eps, bids = _FIRST_EPS * wide, 0
    coarse: tuple[Tree, Floats] | None = None
    for stride in reversed(strides):
        x, y = (_thinned(cloud, stride) for cloud in whole)
        prices = np.zeros(len(y.counts)) if coarse is None else -_least(coarse[0], -coarse[1], y.points, _LOSS * eps)
        values = _least(y.tree, prices, x.points, _LOSS * eps)
        origin = np.repeat(np.arange(len(x.counts), dtype=np.int32), x.counts)
        place = np.full(len(origin), -1, dtype=np.int32)
        guess = np.full(len(x.counts), -1, dtype=np.int32)
        goal, last = 1.0, _LEAST_EPS * extent
        if stride > 1:
            goal, last = _AHEAD, max(_LAST_EPS * wide / math.sqrt(len(origin)), last)
        while True:
            bids += _auction(eps, limit - bids, x, y, origin, values, place, guess, prices)
            values = _least(y.tree, prices, x.points, _LOSS * eps)
            prices = -_least(x.tree, -values, y.points, _LOSS * eps)
            solution = Solution(x, y, values, prices, origin, _seated(place, y.counts), bids)
            excess = enough(stride * solution.dual(), stride * solution.primal())
            if excess <= goal or bids >= limit or eps <= last:
                break
            eps = max(eps / FINER, eps * _AIM * goal / excess, last)
        if stride == 1:
            return solution
        coarse = x.tree, values
    raise AssertionError("the last level has stride 1")


def _treed(points: Floats, counts: Counts) -> tuple[Tree, Counts]:
    tree = build(points)
    return tree, counts[tree.order]


def _thinned(cloud: Cloud, stride: int) -> Cloud:
    """Every `stride`-th unit of mass, in the order of the tree: close to the whole, wherever one looks."""
    if stride == 1:
        return cloud
    unit = np.repeat(np.arange(len(cloud.counts)), cloud.counts)[::stride]
    kept, counts = np.unique(unit, return_counts=True)
    return Cloud(*_treed(cloud.points[kept], counts))


def _least(tree: Tree, prices: Floats, seen_from: Floats, loss: float) -> Floats:
    """The least distance plus price from each point, or up to `loss` below, shape [n]; sets the tree's planes."""
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    values, best = np.empty(len(seen_from)), np.full(len(seen_from), -1, dtype=np.int32)
    least_values(
        seen_from, loss, tree.points, prices, tree.begin, tree.end, tree.nodes, tree.first, values, best
    )  # fmt: skip
    return values


def _auction(
    eps: float, limit: int, a: Cloud, b: Cloud, origin: npt.NDArray[np.int32], values: Floats,
    place: npt.NDArray[np.int32], guess: npt.NDArray[np.int32], prices: Floats,
) -> int:  # fmt: skip
    tree = b.tree
    set_planes(tree.points, prices, tree.begin, tree.end, tree.nodes)
    seats = np.concatenate([[0], np.cumsum(b.counts)])
    return hold_auction(
        eps, _SLACK * eps, limit, a.points, origin, values, place, guess, tree.points, prices, seats, tree.begin,
        tree.end, tree.nodes, tree.leaf, tree.first,
    )  # fmt: skip


def _seated(place: npt.NDArray[np.int32], seats: Counts) -> npt.NDArray[np.int32]:
    """The places, with those that have none on what is free, both in order."""
    waiting = place < 0
    free = seats - np.bincount(place[~waiting], minlength=len(seats))
    if (free < 0).any() or free.sum() != waiting.sum():
        raise RuntimeError("the auction gave away a seat twice")
    seated = place.copy()
    seated[waiting] = np.repeat(np.arange(len(seats)), free)
    return seated


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
