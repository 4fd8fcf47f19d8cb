"""One phase of an auction for places at least distance plus price, and the transform that makes prices good again.

Bertsekas' auction for the assignment problem with its refinement for places of several seats (D. P. Bertsekas,
D. A. Castanon, "The auction algorithm for the transportation problem", Annals of Operations Research 20, 1989).
A bidder takes a seat in the best place and raises its price until that place is only `eps` worse than the next; who
held the seat bids next. When all have seats, each is within `eps` of the best for him.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.transport.compiled import compiled
from gpusimbench.evaluator.transport.kd_tree import DEPTH, Floats, Integers, lift_planes, search

Counts = npt.NDArray[np.int64]


@compiled
def least_values(
    seen_from: Floats, slack: float, points: Floats, prices: Floats, begin: Integers, end: Integers, nodes: Floats,
    first: int, values: Floats, best: Integers,
) -> None:  # fmt: skip
    """Write values[i] = min_j |seen_from[i] - points[j]| + prices[j], and the j that it is found at.

    Values are lower bounds, exact up to `slack` and rounding. `best` holds guesses before, -1 for none.
    """
    stack, bounds = np.empty(DEPTH, np.int32), np.empty(DEPTH)
    for i in range(len(seen_from)):
        x, y = seen_from[i, 0], seen_from[i, 1]
        j, least, other = search(x, y, best[i], slack, points, prices, begin, end, nodes, first, stack, bounds)
        best[i], values[i] = j, min(least, other)


@compiled
def hold_auction(
    eps: float, slack: float, limit: int, bidders: Floats, origin: Integers, values: Floats, place: Integers,
    guess: Integers, points: Floats, prices: Floats, seats: Counts, begin: Integers, end: Integers, nodes: Floats,
    leaf: Integers, first: int,
) -> int:  # fmt: skip
    """Bid until everybody has a seat, or `limit` bids were made; returns the number of bids.

    Args:
        eps: by how much a bidder's place may be worse than his best, > 0.
        slack: of searches, below eps: the least rise of a price is eps - slack.
        limit: bids at most.
        bidders: where bidders are, shape [n_bidder, 2].
        origin: which of these each of the m bidders is at, shape [m].
        values: the least distance plus price from each, shape [n_bidder].
        place: the place of each bidder, or -1, shape [m]; those too far from their best lose it. Changed.
        guess: a place to begin each search with, or -1, shape [n_bidder]. Changed.
        points, prices: the places, shapes [n_place, 2] and [n_place]. Prices are changed.
        seats: the first seat of each place, and the number of all, shape [n_place + 1].
        begin, end, nodes, leaf, first: of the places' tree, planes set. Planes are changed.
    """
    m = len(origin)
    stack, bounds = np.empty(DEPTH, np.int32), np.empty(DEPTH)
    holder, price = np.full(m, -1, np.int32), np.empty(m)
    taken = np.zeros(len(prices), np.int64)
    waiting, n_waiting = np.empty(m, np.int32), 0
    for j in range(len(prices)):
        price[seats[j] : seats[j + 1]] = prices[j]
    for i in range(m):
        j = place[i]
        if j >= 0:
            dx, dy = bidders[origin[i], 0] - points[j, 0], bidders[origin[i], 1] - points[j, 1]
            if np.sqrt(dx * dx + dy * dy) + prices[j] <= values[origin[i]] + eps:
                holder[seats[j] + taken[j]] = i
                taken[j] += 1
            else:
                place[i] = -1
        if place[i] < 0:
            waiting[n_waiting] = i
            n_waiting += 1
    bids = 0
    for turn in range(n_waiting):
        i = waiting[turn]
        while i >= 0 and bids < limit:
            bids += 1
            at = origin[i]
            j, least, other = search(
                bidders[at, 0],
                bidders[at, 1],
                guess[at],
                slack,
                points,
                prices,
                begin,
                end,
                nodes,
                first,
                stack,
                bounds,
            )
            if other == np.inf:  # the only place
                other = least
            guess[at], place[i] = j, j
            seat, evicted = seats[j], holder[seats[j]]
            _reseat(seat, seats[j + 1], i, prices[j] + (other - least) + eps, holder, price)
            if price[seat] > prices[j]:
                prices[j] = price[seat]
                lift_planes(j, points, prices, begin, end, nodes, leaf)
            if evicted >= 0:
                place[evicted] = -1
            i = evicted
    return bids


@compiled
def _reseat(top: int, end: int, who: int, offer: float, holder: Integers, price: Floats) -> None:
    """Give the cheapest seat of a place to `who` for `offer`; its seats [top, end) are a heap, the cheapest on top."""
    k, n = 0, end - top
    while True:
        child = 2 * k + 1
        if child >= n:
            break
        if child + 1 < n and price[top + child + 1] < price[top + child]:
            child += 1
        if price[top + child] >= offer:
            break
        price[top + k], holder[top + k] = price[top + child], holder[top + child]
        k = child
    price[top + k], holder[top + k] = offer, who
