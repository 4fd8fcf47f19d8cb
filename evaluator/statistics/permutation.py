"""Permutation floor: the W1 that two samples of one and the same law already have."""

from __future__ import annotations

from dataclasses import dataclass

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
    n_permutation   permutations drawn
    seed            seed they were drawn with
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
    a, b = point_array(a, "a", ndim=3), point_array(b, "b", ndim=3)
    if a.shape[1:] != b.shape[1:]:
        raise ValueError(f"envs of different shape: {list(a.shape[1:])} and {list(b.shape[1:])}")
    if n_permutation < 1:
        raise ValueError(f"n_permutation must be at least 1, got {n_permutation}")
    envs = in_canonical_order(np.concatenate([a, b]))
    classes = bitwise_classes(envs)
    if classes.max() == 0:
        # One point set throughout: every exchange gives zero, as observed.
        return PermutationFloor(0.0, 0.0, 0.0, 1.0, n_permutation, seed)

    known: dict[bytes, float] = {}

    def between(side: npt.NDArray[np.int64], other: npt.NDArray[np.int64]) -> float:
        # Identical envs are interchangeable: an arrangement is which classes a side holds.
        key = np.sort(classes[side]).tobytes()
        if key not in known:
            known[key] = wasserstein1(_pooled(envs[side]), _pooled(envs[other])).value
        return known[key]

    order = np.arange(len(envs))
    first = wasserstein1(_pooled(a), _pooled(b))
    known[np.sort(classes[: len(a)]).tobytes()] = first.value
    rng = np.random.default_rng(seed)
    floor = np.empty(n_permutation)
    for i in range(n_permutation):
        dealt = rng.permutation(order)
        floor[i] = between(dealt[: len(a)], dealt[len(a) :])
    reached = int((floor >= first.value * (1.0 - _TIE)).sum())
    return PermutationFloor(
        observed=first.value,
        floor_mean=float(floor.mean()),
        floor_q95=float(np.quantile(floor, 0.95)),
        p_value=(1 + reached) / (1 + n_permutation),
        n_permutation=n_permutation,
        seed=seed,
        extension=first.extension,
    )


def _pooled(envs: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """All points of the envs as one set, shape [n_env, n_item, d] -> [n_env * n_item, d]."""
    return envs.reshape(-1, envs.shape[-1])
