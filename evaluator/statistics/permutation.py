"""Permutation tests: the W1 and the energy distance that samples of one law already have, and whether a number goes
with a run's outcome."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.mapping import Mapper, serial
from gpusimbench.evaluator.metrics.identity import bitwise_classes
from gpusimbench.evaluator.metrics.variability import CM_PER_M
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.energy import EnergyDistance, energy_distance
from gpusimbench.evaluator.transport.pair import Transport, wasserstein1
from gpusimbench.evaluator.transport.points import in_canonical_order, point_array

# Arrangements that are equal in exact arithmetic may differ in the last bits; they count as ties.
_TIE = 1e-9

ALPHA = 0.01
"""Chance of a false alarm at most: of a p-value at or below it where numbers do not go with outcomes."""

_DRAWS = 9_999

_AT_ONCE = 1_000_000  # numbers that are permuted at once: 8 MB

_SQUARES_TIE = (
    1e-12  # of the whole sum of squares: arrangements that are equal in exact arithmetic differ in the last bits
)

_SEED = 0

_PERMUTATIONS = ((1000, 99), (2000, 19))
"""Permutations by the number of points a side: one distance costs about n^2.5, and a table should take seconds."""

_ENERGY_PERMUTATIONS = 999

_ENERGY_POINTS = 20_000
"""Of both sides: their distances are some four seconds of computing."""


@dataclass(frozen=True)
class PermutationFloor:
    """An observed W1 beside what exchange of whole envs gives, in the unit of the points.

    observed        W1 between the two sides as they are
    floor_mean      mean W1 over the permutations
    floor_q95       95 % quantile over the permutations
    p_value         chance of a W1 this large if the sides were exchangeable
    n_permutation   permutations drawn, or arrangements where all were looked at
    seed            seed they were drawn with; without a meaning where all were looked at
    extension       what goes beyond the published definition of W1; None where nothing does
    """

    observed: float
    floor_mean: float
    floor_q95: float
    p_value: float
    n_permutation: int
    seed: int
    extension: str | None = None


@dataclass(frozen=True)
class Dealt:
    """W1 between the two sides of a deal, all points of a side pooled.

    envs     positions [any length unit], shape [n_env, n_item, d]
    on_side  envs on the first side
    """

    envs: npt.NDArray[np.float64]
    on_side: int

    def __call__(self, deal: npt.NDArray[np.int64]) -> float:
        """Of all envs in some order, shape [n_env]; ValueError where the distance is only known between bounds."""
        # Sides that were dealt are samples of one law, whatever the envs are.
        sides = _pooled(self.envs[deal[: self.on_side]]), _pooled(self.envs[deal[self.on_side :]])
        return _exact(wasserstein1(*sides, alike=True))


def permutation_floor(
    a: npt.ArrayLike, b: npt.ArrayLike, *, n_permutation: int, seed: int, mapper: Mapper = serial
) -> PermutationFloor:
    """W1 between the pooled points of two groups of envs, with its permutation floor.

    W1 between finite samples is positive even where the laws agree, the more so the fewer the
    points. Envs are dealt anew to two sides of the same sizes; points stay with their env, since
    the items of one env are not independent. The p-value is that of a Monte Carlo test (Phipson and
    Smyth 2010), never zero:

        p = (1 + #{permuted W1 >= observed}) / (1 + n_permutation)

    Args:
        a: positions [any length unit], shape [n_env_a, n_item, d].
        b: positions [same unit], shape [n_env_b, n_item, d].
        n_permutation: permutations to draw, at least 1.
        seed: seed of the draw; all are drawn before any is solved.
        mapper: makes the distances of those that differ.

    Raises:
        ValueError: no permutations; shapes of items differ; positions empty or not finite.
    """
    if n_permutation < 1:
        raise ValueError(f"n_permutation must be at least 1, got {n_permutation}")
    a, b = _sides(a, b)
    rng = np.random.default_rng(seed)
    order = np.arange(len(a) + len(b))
    deals = np.array([rng.permutation(order) for _ in range(n_permutation)])
    return _floor(a, b, deals, mapper, undealt=1, seed=seed)


def arrangements(a: int, b: int) -> int:
    """Ways to deal a + b envs to two sides of a and b that W1 tells apart: it is the same with the sides exchanged."""
    return math.comb(a + b, a) // (2 if a == b else 1)


def exhaustive_floor(a: npt.ArrayLike, b: npt.ArrayLike) -> PermutationFloor:
    """The same over all `arrangements`, the observed one among them: nothing is left to the draw.

        p = #{W1 >= observed} / number of arrangements

    Args:
        a: positions [any length unit], shape [n_env_a, n_item, d].
        b: positions [same unit], shape [n_env_b, n_item, d].

    Raises:
        ValueError: shapes of items differ; positions empty or not finite.
    """
    a, b = _sides(a, b)
    count = len(a) + len(b)
    sides = combinations(range(count), len(a))
    # of two equal sides, the one with env 0
    kept = [side for side in sides if len(a) != len(b) or side[0] == 0]
    deals = np.array([[*side, *sorted(set(range(count)) - set(side))] for side in kept])
    return _floor(a, b, deals, serial, undealt=0, seed=0)


def _sides(a: npt.ArrayLike, b: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    a, b = point_array(a, "a", ndim=3), point_array(b, "b", ndim=3)
    if a.shape[1:] != b.shape[1:]:
        raise ValueError(f"envs of different shape: {list(a.shape[1:])} and {list(b.shape[1:])}")
    return a, b


def _floor(
    a: npt.NDArray[np.float64],
    b: npt.NDArray[np.float64],
    deals: npt.NDArray[np.int64],
    mapper: Mapper,
    *,
    undealt: int,
    seed: int,
) -> PermutationFloor:
    """The observed W1 among those of some deals; undealt: 1 where the observed arrangement is none of them, else 0."""
    observed, extension, floor = _exchange(a, b, deals, mapper)
    reached = int((floor >= observed * (1.0 - _TIE)).sum())
    return PermutationFloor(
        observed=observed,
        floor_mean=float(floor.mean()),
        floor_q95=float(np.quantile(floor, 0.95)),
        p_value=(undealt + reached) / (undealt + len(deals)),
        n_permutation=len(deals),
        seed=seed,
        extension=extension,
    )


def _exchange(
    a: npt.NDArray[np.float64], b: npt.NDArray[np.float64], deals: npt.NDArray[np.int64], mapper: Mapper
) -> tuple[float, str | None, npt.NDArray[np.float64]]:
    """The observed W1, its extension, and the W1 of each deal, shape [n_deal]."""
    envs = in_canonical_order(np.concatenate([a, b]))
    classes = bitwise_classes(envs)
    if classes.max() == 0:
        # One point set throughout: every exchange gives zero, as observed.
        return 0.0, None, np.zeros(len(deals))
    observed = wasserstein1(_pooled(a), _pooled(b))
    known = {_arrangement(classes, len(a)): _exact(observed)}
    keys = [_arrangement(classes[deal], len(a)) for deal in deals]
    new = {key: i for i, key in reversed(list(enumerate(keys))) if key not in known}
    if new:
        chosen = sorted(new.values())
        known.update(zip((keys[i] for i in chosen), mapper(Dealt(envs, len(a)), deals[chosen]), strict=True))
    return observed.value, observed.extension, np.array([known[key] for key in keys])


def _arrangement(dealt: npt.NDArray[np.int64], on_side: int) -> bytes:
    # Identical envs are interchangeable, and so are sides of one size: it matters which classes are together.
    side, other = np.sort(dealt[:on_side]).tobytes(), np.sort(dealt[on_side:]).tobytes()
    return min(side, other) if len(side) == len(other) else side


def _exact(found: Transport) -> float:
    if found.exactness != "exact":
        raise ValueError("too many points a side: bounds of W1 cannot be ranked as its values can")
    return found.value


def _pooled(envs: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """All points of the envs as one set, shape [n_env, n_item, d] -> [n_env * n_item, d]."""
    return envs.reshape(-1, envs.shape[-1])


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
    most = within(rows)[0] + _SQUARES_TIE * np.var(rows) * len(found)
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


@dataclass(frozen=True)
class Floor:
    """What exchanging whole environments between two sides gives, in cm.

    w1      for W1
    energy  for the energy distance
    """

    w1: PermutationFloor | Missing = Missing("it was not computed")
    energy: EnergyDistance | Missing = Missing("it was not computed")


def floor(a: NDArray[np.float64], b: NDArray[np.float64], mapper: Mapper) -> Floor:
    """What W1 and energy distance [cm] are between two samples of one law: whole envs of a and b exchanged at random.

    a, b    planar positions [m], shape [env, item, 2]
    mapper  makes the distances
    """
    if all((side == side[:1]).all() for side in (a, b)):
        alike = Missing("the environments of a side are identical: there is nothing to exchange")
        return Floor(alike, alike)
    a, b = a * CM_PER_M, b * CM_PER_M
    return Floor(_of_w1(a, b, mapper), _of_energy(a, b))


def _of_w1(a: NDArray[np.float64], b: NDArray[np.float64], mapper: Mapper) -> PermutationFloor | Missing:
    points = max(a.shape[0] * a.shape[1], b.shape[0] * b.shape[1])
    permutations = next((count for limit, count in _PERMUTATIONS if points <= limit), None)
    if permutations is None:
        return Missing(f"{points} points a side are too many for a permutation test")
    return permutation_floor(a, b, n_permutation=permutations, seed=_SEED, mapper=mapper)


def _of_energy(a: NDArray[np.float64], b: NDArray[np.float64]) -> EnergyDistance | Missing:
    points = a.shape[0] * a.shape[1] + b.shape[0] * b.shape[1]
    if points > _ENERGY_POINTS:
        return Missing(f"{points} points are too many for their energy distance")
    return energy_distance(a, b, n_permutation=_ENERGY_PERMUTATIONS, seed=_SEED)
