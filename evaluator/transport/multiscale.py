"""An assignment and prices for many points: auctions on ever more of them, each beginning at the prices of the last.

Prices are a function over the plane that hardly depends on how many points it is drawn from. So the long way of prices
is gone with few points, and all points only settle what is left. After each auction prices are replaced by

    p_j = max_i (u_i - |x_i - y_j|),   u_i = min_j (|x_i - y_j| + p_j),

which are feasible with the same u and nowhere higher. That takes most of the error out of the lower bound, and the
noise of bidding out of the prices, without which the next auction would search and bid several times as much.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.transport.auction import Counts, hold_auction, least_values
from gpusimbench.evaluator.transport.kd_tree import Floats, Tree, build, set_planes

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
