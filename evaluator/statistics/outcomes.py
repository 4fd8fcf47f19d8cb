"""Whether a number that each run has goes with the outcome of the run: a permutation test."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import numpy.typing as npt

ALPHA = 0.01
"""Chance of a false alarm at most: of a p-value at or below it where numbers do not go with outcomes."""

_DRAWS = 9_999
_TIE = 1e-12  # of the whole sum of squares: arrangements that are equal in exact arithmetic differ in the last bits
_AT_ONCE = 1_000_000  # numbers that are permuted at once: 8 MB


def ranges_of(values: npt.ArrayLike, outcomes: npt.ArrayLike) -> list[tuple[int, float, float]]:
    """Runs of each outcome, their smallest and their largest value; the outcome with the smallest value first.

    Args:
        values: one a run, shape [n_run].
        outcomes: of the runs, as numbers, shape [n_run].
    """
    found, labels = np.asarray(values, dtype=np.float64), np.asarray(outcomes)
    ours = [found[labels == label] for label in np.unique(labels)]
    return sorted(((len(x), float(x.min()), float(x.max())) for x in ours), key=lambda one: one[1:])


def p_value(values: npt.ArrayLike, outcomes: npt.ArrayLike) -> float:
    """Chance that outcomes leave as little spread of values within them, if values did not go with outcomes.

    The statistic is the sum of squares within outcomes, which orders arrangements as the F of a one-way analysis of
    variance does (Fisher 1935; Pitman 1938), and is defined where that has a denominator of zero. With 9,999 random
    permutations of the values (Phipson and Smyth 2010),

        p = (1 + #{permuted sum <= observed}) / (1 + 9,999)

    The test needs no law of the values: if runs can be exchanged, p <= alpha has a probability of at most alpha.

    Args:
        values: one a run, finite, shape [n_run].
        outcomes: of the runs, as numbers, shape [n_run].

    Returns:
        p; 1 where no two outcomes have ranges apart, or where so few runs cannot reach ALPHA.

    Raises:
        ValueError: shapes differ, or a value is not finite.
    """
    found, labels = np.asarray(values, dtype=np.float64), np.asarray(outcomes)
    if found.ndim != 1 or found.shape != labels.shape:
        raise ValueError(f"shapes must be [n_run] both, got {list(found.shape)} and {list(labels.shape)}")
    if not np.isfinite(found).all():
        raise ValueError("values must be finite")
    sides = [found[labels == label] for label in np.unique(labels)]
    if _least(sides) > ALPHA or not any(_apart(a, b) for a, b in combinations(sides, 2)):
        return 1.0
    ends = np.cumsum([len(side) for side in sides])[:-1]

    def within(rows: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        parts = np.split(rows, ends, axis=1)
        return np.asarray(sum(np.var(part, axis=1) * part.shape[1] for part in parts))

    rows = np.concatenate(sides)[np.newaxis]
    most = within(rows)[0] + _TIE * np.var(rows) * len(found)
    rng, at_once, reached = np.random.default_rng(0), max(1, _AT_ONCE // len(found)), 0
    for begin in range(0, _DRAWS, at_once):
        drawn = rng.permuted(np.repeat(rows, min(at_once, _DRAWS - begin), axis=0), axis=1)
        reached += int((within(drawn) <= most).sum())
    return (1 + reached) / (1 + _DRAWS)


def _apart(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> bool:
    return bool(a.max() < b.min() or b.max() < a.min())


def _least(sides: list[npt.NDArray[np.float64]]) -> float:
    """The smallest p-value that outcomes of these sizes can have: sides of one size can be exchanged."""
    sizes = [len(side) for side in sides]
    arrangements = math.factorial(sum(sizes)) // math.prod(map(math.factorial, sizes))
    alike = math.prod(math.factorial(sizes.count(size)) for size in set(sizes))
    return alike / arrangements
