"""Compiled: the assignment between small point sets, costs included, in microseconds.

The method is that of Jonker and Volgenant (1987) in the form of Crouse (2016): feasible prices and a partial
assignment first, then one shortest augmenting path for every row that is left. Two things are different here. Prices
start from the means of the columns, which is where the optimum lies if one cloud is a shifted copy of the other. And
the inner loop is a plain minimum over one row, which compilers turn into vector instructions: columns that a path has
passed are given an absurd price instead of being left out, and which row reached a column first is not kept but worked
out again for the few columns on the path.

Importing this compiles nothing; the first call does, for seconds, and keeps the machine code beside this file or, where
that cannot be written, in the user's cache folder.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.transport.compiled import compiled_without_nan

_Floats = npt.NDArray[np.float64]
_Ints = npt.NDArray[np.int64]

# Larger than any distance between scaled points; twice it is still finite.
_HUGE = 1e300
# Rows of the cost matrix are padded to whole vectors.
_LANES = 4


@compiled_without_nan
def _fill(a: _Floats, b: _Floats, cost: _Floats) -> None:
    """Distances between a and b, both [d, n], into cost [n, >= n]."""
    width, n = a.shape
    for i in range(n):
        row = cost[i]
        for k in range(width):
            x, other = a[k, i], b[k]
            if k == 0:
                for j in range(n):
                    row[j] = (x - other[j]) * (x - other[j])
            else:
                for j in range(n):
                    row[j] += (x - other[j]) * (x - other[j])
        for j in range(n):
            row[j] = np.sqrt(row[j])


@compiled_without_nan
def _start(cost: _Floats, price: _Floats, column_of: _Ints, row_of: _Ints, best: _Ints) -> None:
    """Feasible prices, and rows assigned to columns where no two want the same one; -1 where one is free."""
    n, padded = cost.shape
    price[:] = 0.0
    for i in range(n):
        row = cost[i]
        for j in range(n):
            price[j] += row[j]
    for j in range(n):
        price[j] /= n
    column_of[:] = -1
    row_of[:] = -1
    # What every row has left over the means of the columns, then every column over what the rows offer.
    offers = np.empty(n)
    for i in range(n):
        row = cost[i]
        cheapest = _HUGE
        for j in range(n):
            cheapest = min(cheapest, row[j] - price[j])
        offers[i] = cheapest
    for j in range(padded):
        price[j] = _HUGE
    for i in range(n):
        row = cost[i]
        offer = offers[i]
        for j in range(padded):
            reduced = row[j] - offer
            lower = reduced < price[j]
            price[j] = reduced if lower else price[j]
            best[j] = i if lower else best[j]
    for j in range(n):
        i = best[j]
        if column_of[i] < 0:
            column_of[i] = j
            row_of[j] = i
    for j in range(n, padded):
        price[j] = 0.0


@compiled_without_nan
def _solve(cost: _Floats, price: _Floats, column_of: _Ints, row_of: _Ints) -> None:
    """The optimal assignment of the n rows of cost [n, padded]; what is beyond column n is _HUGE.

    Fills column_of [n] and row_of [padded]. Prices [padded] are the dual certificate: for every row
    its assigned column is one of least cost - price.
    """
    n, padded = cost.shape
    reached = np.empty(padded)  # length of the shortest path to a column; _HUGE once it is passed
    shown = np.empty(padded)  # the prices, absurd for columns that are passed
    length = np.empty(padded)  # of the path to a column, when it was passed
    passed_at = np.empty(padded, np.int64)  # how many rows had been looked at by then
    rows = np.empty(n + 1, np.int64)  # that were looked at, in order
    offset = np.empty(n + 1)  # what is taken off each one's reduced costs
    _start(cost, price, column_of, row_of, passed_at)
    shown[:] = price
    for free in range(n):
        if column_of[free] >= 0:
            continue
        reached[:] = _HUGE
        i, off, seen = np.int64(free), 0.0, 0
        while True:
            rows[seen], offset[seen] = i, off
            seen += 1
            row = cost[i]
            nearest = _HUGE
            for j in range(padded):
                to = min(reached[j], row[j] - shown[j] - off)
                reached[j] = to
                nearest = min(nearest, to)
            last = 0
            while reached[last] != nearest:
                last += 1
            length[last], passed_at[last] = nearest, seen
            i = row_of[last]
            if i < 0:
                break
            reached[last] = _HUGE
            shown[last] = -_HUGE
            off = cost[i, last] - price[last] - nearest
        column = np.int64(last)
        while True:  # back along the path, by the same sums that led there
            shortest, before = _HUGE, free
            for k in range(passed_at[column]):
                to = cost[rows[k], column] - price[column] - offset[k]
                if to < shortest:
                    shortest, before = to, rows[k]
            row_of[column] = before
            column_of[before], column = column, column_of[before]
            if before == free:
                break
        for j in range(n):
            if reached[j] == _HUGE:
                price[j] += length[j] - nearest
                shown[j] = price[j]


@compiled_without_nan
def _mean_cost(a: _Floats, b: _Floats, cost: _Floats, price: _Floats, column_of: _Ints, row_of: _Ints) -> float:
    _fill(a, b, cost)
    _solve(cost, price, column_of, row_of)
    n = len(cost)
    total = 0.0
    for i in range(n):
        total += cost[i, column_of[i]]
    return total / n


@compiled_without_nan
def distances_to_later(sets: _Floats, row: int, out: _Floats) -> None:
    """W1 from one set to all behind it, without holding the interpreter's lock.

    Args:
        sets: scaled points, at most 2 apart in each coordinate from the origin, shape [n_set, d, n_item].
        row: number of the set.
        out: filled beyond `row` with the distances, shape [n_set].
    """
    n = sets.shape[2]
    padded = -(-n // _LANES) * _LANES
    cost = np.full((n, padded), _HUGE)
    price = np.empty(padded)
    column_of, row_of = np.empty(n, np.int64), np.empty(padded, np.int64)
    for other in range(row + 1, len(sets)):
        out[other] = _mean_cost(sets[row], sets[other], cost, price, column_of, row_of)


def assigned_columns(distance: _Floats) -> _Ints:
    """The column of every row in the assignment of least mean distance, shape [n].

    distance  square, at least 0 and far below 1e300, shape [n, n]
    """
    n = len(distance)
    padded = -(-n // _LANES) * _LANES
    cost = np.full((n, padded), _HUGE)
    cost[:, :n] = distance
    columns, rows = np.empty(n, np.int64), np.empty(padded, np.int64)
    _solve(cost, np.empty(padded), columns, rows)
    return columns
