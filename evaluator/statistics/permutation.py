"""Permutation floor: the W1 that two samples of one and the same law already have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from evaluator.metrics.identity import bitwise_classes
from evaluator.transport.pair import in_canonical_order, point_array, wasserstein1

# Arrangements that are equal in exact arithmetic may differ in the last bits; they count as ties.
_TIE = 1e-9


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


def permutation_floor(a: npt.ArrayLike, b: npt.ArrayLike, *, n_permutation: int, seed: int) -> PermutationFloor:
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
        seed: seed of the draw.

    Raises:
        ValueError: no permutations; shapes of items differ; positions empty or not finite.
    """
    if n_permutation < 1:
        raise ValueError(f"n_permutation must be at least 1, got {n_permutation}")
    a, b = _sides(a, b)
    rng = np.random.default_rng(seed)
    order = np.arange(len(a) + len(b))
    observed, extension, between = _exchange(a, b)
    floor = np.empty(n_permutation)
    for i in range(n_permutation):
        floor[i] = between(rng.permutation(order))
    return PermutationFloor(
        observed=observed,
        floor_mean=float(floor.mean()),
        floor_q95=float(np.quantile(floor, 0.95)),
        p_value=(1 + _reached(floor, observed)) / (1 + n_permutation),
        n_permutation=n_permutation,
        seed=seed,
        extension=extension,
    )


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
    observed, extension, between = _exchange(a, b)
    deals = combinations(range(count), len(a))
    # of two equal sides, the one with env 0
    kept = [deal for deal in deals if len(a) != len(b) or deal[0] == 0]
    floor = np.array([between(np.array([*deal, *sorted(set(range(count)) - set(deal))])) for deal in kept])
    return PermutationFloor(
        observed=observed,
        floor_mean=float(floor.mean()),
        floor_q95=float(np.quantile(floor, 0.95)),
        p_value=_reached(floor, observed) / len(kept),
        n_permutation=len(kept),
        seed=0,
        extension=extension,
    )


def _sides(a: npt.ArrayLike, b: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    a, b = point_array(a, "a", ndim=3), point_array(b, "b", ndim=3)
    if a.shape[1:] != b.shape[1:]:
        raise ValueError(f"envs of different shape: {list(a.shape[1:])} and {list(b.shape[1:])}")
    return a, b


def _exchange(
    a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]
) -> tuple[float, str | None, Callable[[npt.NDArray[np.int64]], float]]:
    """The observed W1, its extension, and W1 by the order in which all envs are dealt."""
    envs = in_canonical_order(np.concatenate([a, b]))
    classes = bitwise_classes(envs)
    if classes.max() == 0:
        # One point set throughout: every exchange gives zero, as observed.
        return 0.0, None, lambda dealt: 0.0

    known: dict[bytes, float] = {}

    def between(dealt: npt.NDArray[np.int64]) -> float:
        # Identical envs are interchangeable: an arrangement is which classes a side holds.
        side, other = dealt[: len(a)], dealt[len(a) :]
        key = np.sort(classes[side]).tobytes()
        if key not in known:
            known[key] = wasserstein1(_pooled(envs[side]), _pooled(envs[other])).value
        return known[key]

    first = wasserstein1(_pooled(a), _pooled(b))
    known[np.sort(classes[: len(a)]).tobytes()] = first.value
    return first.value, first.extension, between


def _reached(floor: npt.NDArray[np.float64], observed: float) -> int:
    return int((floor >= observed * (1.0 - _TIE)).sum())


def _pooled(envs: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """All points of the envs as one set, shape [n_env, n_item, d] -> [n_env * n_item, d]."""
    return envs.reshape(-1, envs.shape[-1])
