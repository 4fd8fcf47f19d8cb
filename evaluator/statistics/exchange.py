"""Do two sides differ? Tests that deal runs anew to the two sides, within blocks of neighbours in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
import numpy.typing as npt

MOST_DEALINGS = 20_000
"""Up to so many dealings are all looked at."""

DRAWN = 9_999
"""Of more, so many are drawn; fewer of very many runs, whose dealings take as much memory as MOST_CELLS."""

MOST_CELLS = 20_000_000
_FEWEST_DRAWN = 999

_TIE = 1e-9  # dealings that are equal in exact arithmetic may differ in the last bits

Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Dealings:
    """Ways to deal runs to two sides that have as many as observed, in every block.

    head        whether a run is on the second side, shape [dealing, run]; the first dealing is the observed one
    exhaustive  whether these are all that there are; otherwise they were drawn with `seed`
    """

    head: Bools
    exhaustive: bool
    seed: int


@dataclass(frozen=True)
class Shift:
    """How far the second side lies from the first, in the unit of the values.

    difference  mean of the second minus mean of the first: the mean of the blocks' differences, by their precision
    low, high   every shift that the test does not reject; None where so few runs exclude none
    p_value     share of the dealings whose difference is as large, of either sign; the observed one is among them
    least_p     the smallest that so many runs can give
    n           dealings that were looked at
    exhaustive  whether these are all
    seed        of those that were drawn
    """

    difference: float
    low: float | None
    high: float | None
    p_value: float
    least_p: float
    n: int
    exhaustive: bool
    seed: int

    @property
    def ways(self) -> str:
        """How many dealings were looked at, in words; the observed one is not among those that were drawn."""
        return f"all {self.n} ways" if self.exhaustive else f"{self.n - 1} ways drawn with seed {self.seed}"


def count_dealings(head: npt.ArrayLike, blocks: npt.ArrayLike) -> int:
    """How many ways there are to deal the runs: the product over blocks of (runs choose runs of the second side)."""
    return math.prod(math.comb(len(side), int(side.sum())) for side in _sides(head, blocks))


def least_p(head: npt.ArrayLike, blocks: npt.ArrayLike) -> float:
    """The smallest two-sided p-value of a test within blocks.

    Where every block has as many runs of either side, the dealing that exchanges the sides is there too, and counts.
    """
    sides = _sides(head, blocks)
    mirrored = all(2 * int(side.sum()) == len(side) for side in sides)
    count = count_dealings(head, blocks)
    return (1 + mirrored) / count if count <= MOST_DEALINGS else 1 / (1 + _drawn(sum(map(len, sides))))


def dealings(head: npt.ArrayLike, blocks: npt.ArrayLike, *, seed: int = 0) -> Dealings:
    """All ways to deal the runs within their blocks; of more than MOST_DEALINGS, some that are drawn.

    Args:
        head: whether a run is on the second side, shape [run].
        blocks: the block of each run, shape [run].
        seed: of the draw.

    Raises:
        ValueError: the shapes differ.
    """
    observed, labels = _arrays(head, blocks)
    members = [np.flatnonzero(labels == block) for block in np.unique(labels)]
    if count_dealings(observed, labels) > MOST_DEALINGS:
        rng = np.random.default_rng(seed)
        count = _drawn(len(observed))
        drawn = np.empty((count + 1, len(observed)), dtype=bool)
        drawn[0] = observed
        for inside in members:
            drawn[1:, inside] = rng.permuted(np.tile(observed[inside], (count, 1)), axis=1)
        return Dealings(drawn, exhaustive=False, seed=seed)
    choices = [list(combinations(inside.tolist(), int(observed[inside].sum()))) for inside in members]
    found = np.zeros((math.prod(map(len, choices)), len(observed)), dtype=bool)
    for row, chosen in zip(found, product(*choices), strict=True):
        row[[run for part in chosen for run in part]] = True
    first = int(np.flatnonzero((found == observed).all(axis=1))[0])
    found[[0, first]] = found[[first, 0]]
    return Dealings(found, exhaustive=True, seed=seed)


def compare_means(
    values: npt.ArrayLike, head: npt.ArrayLike, blocks: npt.ArrayLike, *, confidence: float = 0.95
) -> Shift:
    """Difference of two means, with the p-value of a permutation test and the interval that inverts it.

        T = sum_b w_b (mean of the second side in b - mean of the first) / sum_b w_b,   w_b = n1 n2 / (n1 + n2)
        p = #{|T of a dealing| >= |T observed|} / number of dealings

    which is exact where runs of a block can be exchanged (Fisher 1935, Pitman 1937; for draws Phipson and Smyth 2010):
    what changes slowly, such as the clock of a machine, is nearly the same for neighbours. A shift d of the second side
    makes T of each dealing a linear function of d, so each dealing is as large as the observed one on one interval of
    d, and the shifts that are not rejected lie between two order statistics of their ends.

    Args:
        values: one value per run, shape [run]; logarithms, for a ratio.
        head: whether a run is on the second side, shape [run].
        blocks: the block of each run, shape [run]; each has runs of both sides.
        confidence: of the interval.

    Raises:
        ValueError: the shapes differ, values are not finite, or a block has runs of one side alone.
    """
    observed, labels = _arrays(head, blocks)
    found = np.asarray(values, dtype=np.float64)
    if found.shape != observed.shape or not np.isfinite(found).all():
        raise ValueError("values must be finite, one for each run")
    dealt = dealings(observed, labels)
    coefficients = _coefficients(dealt.head, observed, labels)
    centred = found - found.mean()  # weights add up to zero, so this loses only rounding
    shifts = coefficients @ centred
    overlap = coefficients @ observed.astype(np.float64)
    reached = int((np.abs(shifts) >= abs(shifts[0]) - _tie_of(shifts)).sum())
    low, high = _inverted(shifts, overlap, 1.0 - confidence)
    return Shift(
        float(shifts[0]),
        low,
        high,
        reached / len(shifts),
        least_p(observed, labels),
        len(shifts),
        dealt.exhaustive,
        dealt.seed,
    )


def compare_distances(matrix: npt.ArrayLike, head: npt.ArrayLike) -> Shift:
    """Whether two sides of runs lie apart in their distances from each other, any run exchanged with any.

        T = mean distance between the sides - (mean distance within the first + mean within the second) / 2

    half of the energy statistic of Szekely and Rizzo for the metric of the matrix, over pairs of different runs. The
    test is one-sided: sides that agree have a T around zero, whatever their runs do among themselves.

    Args:
        matrix: distances between runs [any unit], shape [run, run]; symmetric.
        head: whether a run is on the second side, shape [run]; at least two runs on each.

    Returns:
        the difference is T, in the unit of the matrix; no interval.

    Raises:
        ValueError: not a square matrix of finite numbers, or a side of fewer than two runs.
    """
    found = _distances_between(matrix, head)
    within1, within2, between = found.means()
    apart = between - (within1 + within2) / 2.0
    # one-sided, and the least p is that of a two-sided test: with as many runs on either side, the exchanged sides are
    # as far apart
    return found.shift(apart, apart >= apart[0] - _tie_of(apart))


def compare_within(matrix: npt.ArrayLike, head: npt.ArrayLike) -> Shift:
    """Whether runs of one side lie further from each other than runs of the other, any run exchanged with any.

        T = mean distance within the second - mean distance within the first

    The test is two-sided, and exact where runs of both sides have one law. Arguments, result and errors are those of
    `compare_distances`.
    """
    found = _distances_between(matrix, head)
    within1, within2, _ = found.means()
    further = within2 - within1
    return found.shift(further, np.abs(further) >= abs(further[0]) - _tie_of(further))


@dataclass(frozen=True)
class _Distances:
    """Distances between runs, and how the runs are dealt to the two sides."""

    matrix: Floats
    head: Bools
    dealt: Dealings

    @property
    def n(self) -> tuple[int, int]:
        second = int(self.head.sum())
        return len(self.head) - second, second

    def means(self) -> tuple[Floats, Floats, Floats]:
        """Mean distance within the first side, within the second and between them, of each dealing."""
        n1, n2 = self.n
        second = self.dealt.head.astype(np.float64)
        first = 1.0 - second
        to_second = second @ self.matrix  # of each run, [dealing, run]
        within2 = (to_second * second).sum(axis=1) / (n2 * (n2 - 1))
        between = (to_second * first).sum(axis=1) / (n1 * n2)
        within1 = ((first @ self.matrix) * first).sum(axis=1) / (n1 * (n1 - 1))
        return within1, within2, between

    def shift(self, statistic: Floats, reaches: Bools) -> Shift:
        """The statistic of the observed dealing, and its p: the share of dealings that reach it."""
        return Shift(
            float(statistic[0]),
            None,
            None,
            int(reaches.sum()) / len(statistic),
            least_p(self.head, np.zeros(len(self.head))),
            len(statistic),
            self.dealt.exhaustive,
            self.dealt.seed,
        )


def _distances_between(matrix: npt.ArrayLike, head: npt.ArrayLike) -> _Distances:
    found = np.asarray(matrix, dtype=np.float64)
    observed, labels = _arrays(head, np.zeros(len(found), dtype=np.int64))
    if found.shape != (len(observed), len(observed)) or not np.isfinite(found).all():
        raise ValueError("distances must be finite, in a square matrix")
    if min(observed.sum(), len(observed) - observed.sum()) < 2:
        raise ValueError("needs at least two runs a side")
    return _Distances(found, observed, dealings(observed, labels))


def _tie_of(shifts: Floats) -> float:
    return _TIE * max(float(np.abs(shifts).max()), 1e-300)


def _drawn(runs: int) -> int:
    return min(DRAWN, max(_FEWEST_DRAWN, MOST_CELLS // runs))


def _coefficients(dealt: Bools, observed: Bools, labels: Ints) -> Floats:
    """What each run's value counts in T, shape [dealing, run]."""
    on_second, on_first = np.zeros(len(observed)), np.zeros(len(observed))
    total = 0.0
    for block in np.unique(labels):
        inside = labels == block
        n2 = int(observed[inside].sum())
        n1 = int(inside.sum()) - n2
        if not n1 or not n2:
            raise ValueError(f"block {block} has runs of one side alone")
        weight = n1 * n2 / (n1 + n2)
        on_second[inside], on_first[inside] = weight / n2, -weight / n1
        total += weight
    return np.where(dealt, on_second, on_first) / total


def _inverted(shifts: Floats, overlap: Floats, alpha: float) -> tuple[float | None, float | None]:
    # |shift_k - d overlap_k| >= |shift_0 - d| on the interval of d with these ends; on all d where |overlap| is 1
    usual = np.abs(overlap) < 1.0 - _TIE
    ends = np.stack(
        [
            (shifts[0] - shifts[usual]) / (1.0 - overlap[usual]),
            (shifts[0] + shifts[usual]) / (1.0 + overlap[usual]),
        ]
    )
    kept = int(math.floor(alpha * len(shifts) * (1.0 + _TIE))) - int((~usual).sum())
    if kept < 0 or not ends.size:
        return None, None
    lower, upper = np.sort(ends.min(axis=0)), np.sort(ends.max(axis=0))[::-1]
    return float(lower[kept]), float(upper[kept])


def _sides(head: npt.ArrayLike, blocks: npt.ArrayLike) -> Sequence[Bools]:
    observed, labels = _arrays(head, blocks)
    return [observed[labels == block] for block in np.unique(labels)]


def _arrays(head: npt.ArrayLike, blocks: npt.ArrayLike) -> tuple[Bools, Ints]:
    observed, labels = np.asarray(head, dtype=bool), np.asarray(blocks, dtype=np.int64)
    if observed.ndim != 1 or observed.shape != labels.shape or not observed.size:
        raise ValueError("head and blocks must have one entry for each run")
    return observed, labels
