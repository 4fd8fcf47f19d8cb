"""Energy distance between two groups of envs, with a permutation test that costs next to nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.identity import bitwise_classes
from gpusimbench.evaluator.transport.points import in_canonical_order, planar_array

MAX_ENVS = 8192
"""Distinct envs of both sides together; the matrix of their sums then takes 0.5 GiB."""

_BLOCK_NUMBERS = 1 << 22  # distances at a time: 32 MiB
_TIE = 1e-9  # of the mean distance; what cancels in exact arithmetic leaves the last bits of its terms


@dataclass(frozen=True)
class EnergyDistance:
    """Energy distance between two groups of envs, in the unit of the points (it is not squared).

    v_statistic    of the points as they are, never negative. Biased upwards. A difference of large sums: zero where it
                   is below 1e-9 of the mean distance, which displacements of 1e-5 of it already are
    u_statistic    without bias where envs are independent draws: pairs of points of one env are left out. May be
                   negative where the laws agree
    floor_mean     mean of the V-statistic over the permutations
    floor_q95      95 % quantile over the permutations
    p_value        chance of a V-statistic this large if whole envs were exchangeable
    n_permutation  permutations drawn
    seed           that they were drawn with
    """

    v_statistic: float
    u_statistic: float | None
    floor_mean: float
    floor_q95: float
    p_value: float
    n_permutation: int
    seed: int


def energy_distance(a: npt.ArrayLike, b: npt.ArrayLike, *, n_permutation: int = 9999, seed: int) -> EnergyDistance:
    """Energy distance in the plane (Szekely and Rizzo 2013), and its permutation test over whole envs.

        2 E|X - Y| - E|X - X'| - E|Y - Y'|

    It is zero if and only if the laws are equal, as W1 is, but it is another number: not to be compared with W1, nor
    with published values. Its sums over pairs of envs do not change when envs are exchanged, so that they are made once
    (n m distances, in blocks) and each permutation only adds them up anew. The p-value is that of a Monte Carlo test
    (Phipson and Smyth 2010), (1 + #{permuted >= observed}) / (1 + n_permutation).

    Envs are what is exchanged, and what is taken for independent. Envs of one run are not where runs differ as a whole:
    to compare two configurations of several runs each, give runs as the envs, [n_run, n_env * n_item, 2].

    The U-statistic needs two envs a side, and is None without.

    Args:
        a: planar positions [any length unit], shape [n_env_a, n_item, 2].
        b: planar positions [same unit], shape [n_env_b, n_item, 2].
        n_permutation: permutations to draw, at least 1.
        seed: of the draw.

    Raises:
        ValueError: no permutations; numbers of items differ; positions empty, not planar or not finite; more than
            MAX_ENVS distinct envs.
    """
    if n_permutation < 1:
        raise ValueError(f"n_permutation must be at least 1, got {n_permutation}")
    a, b = planar_array(a, "a", ndim=3), planar_array(b, "b", ndim=3)
    if a.shape[1] != b.shape[1]:
        raise ValueError(f"envs of different numbers of items: {a.shape[1]} and {b.shape[1]}")
    envs = in_canonical_order(np.concatenate([a, b]))
    classes = bitwise_classes(envs)
    _, first = np.unique(classes, return_index=True)
    if len(first) > MAX_ENVS:
        raise ValueError(f"{len(first)} distinct envs are too many for one matrix (limit: {MAX_ENVS}); take fewer")
    means = env_pair_means(envs[first])
    counts = _Counts(means, classes, len(a), len(b))
    observed = float(counts.v_statistic(counts.dealt(np.arange(len(classes)))[np.newaxis])[0])
    unbiased = counts.u_statistic()
    floor = _permuted(counts, n_permutation, np.random.default_rng(seed))
    tie = _TIE * float(means.mean())
    return EnergyDistance(
        v_statistic=observed if observed > tie else 0.0,
        u_statistic=0.0 if unbiased is not None and abs(unbiased) <= tie else unbiased,
        floor_mean=max(float(floor.mean()), 0.0),
        floor_q95=max(float(np.quantile(floor, 0.95)), 0.0),
        p_value=(1 + int((floor >= observed - tie).sum())) / (1 + n_permutation),
        n_permutation=n_permutation,
        seed=seed,
    )


def env_pair_means(envs: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Mean distance between the points of each pair of envs, a pair of one env with itself included.

    Args:
        envs: positions [any length unit], shape [n_env, n_item, d].

    Returns:
        means [same unit], shape [n_env, n_env], symmetric.
    """
    from scipy.spatial.distance import cdist

    n_env, n_item, width = envs.shape
    points = envs.reshape(-1, width)
    means = np.empty((n_env, n_env))
    begin = 0
    while begin < n_env:
        # as many envs at a time as the block of distances to all later ones has room for
        later = (n_env - begin) * n_item
        stop = min(n_env, begin + max(1, _BLOCK_NUMBERS // (later * n_item)))
        distance = cdist(points[begin * n_item : stop * n_item], points[begin * n_item :])
        block = distance.reshape(stop - begin, n_item, n_env - begin, n_item).mean(axis=(1, 3))
        own = block[:, : stop - begin]
        block[:, : stop - begin] = (own + own.T) / 2  # sums of the same numbers in two orders
        means[begin:stop, begin:] = block
        means[begin:, begin:stop] = block.T
        begin = stop
    if not np.isfinite(means).all():
        raise ValueError("coordinates are too large: their distances overflow float64")
    return means


class _Counts:
    """The statistics from how many envs of each class are on side a; identical envs are interchangeable."""

    def __init__(self, means: npt.NDArray[np.float64], classes: npt.NDArray[np.int64], n_a: int, n_b: int) -> None:
        self.classes = classes
        self.n_a, self.n_b = n_a, n_b
        self._means = means
        self._all = np.bincount(classes).astype(np.float64)
        self._to_all = means @ self._all
        self._total = float(self._all @ self._to_all)

    def dealt(self, order: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """Envs of each class on side a, shape [class], where the envs are dealt in this order."""
        return np.bincount(self.classes[order[: self.n_a]], minlength=len(self._all)).astype(np.float64)

    def v_statistic(self, counts: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """The V-statistic of deals, counts [deal, class]; shape [deal]."""
        of_a = ((counts @ self._means) * counts).sum(axis=1)
        from_a = counts @ self._to_all
        between, of_b = from_a - of_a, self._total - 2 * from_a + of_a
        n, m = self.n_a, self.n_b
        return np.asarray(2 * between / (n * m) - of_a / n**2 - of_b / m**2)

    def u_statistic(self) -> float | None:
        """The U-statistic of the sides as they are; None where a side has one environment."""
        n, m = self.n_a, self.n_b
        if n < 2 or m < 2:
            return None
        a = self.dealt(np.arange(n + m))
        b = self._all - a
        own = np.diagonal(self._means)
        of_a, of_b = float(a @ self._means @ a - a @ own), float(b @ self._means @ b - b @ own)
        return float(2 * (a @ self._means @ b) / (n * m) - of_a / (n * (n - 1)) - of_b / (m * (m - 1)))


def _permuted(counts: _Counts, n_permutation: int, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    n_env = len(counts.classes)
    some = max(1, _BLOCK_NUMBERS // n_env)
    parts = []
    for begin in range(0, n_permutation, some):
        deals = [counts.dealt(rng.permutation(n_env)) for _ in range(begin, min(begin + some, n_permutation))]
        parts.append(counts.v_statistic(np.stack(deals)))
    return np.concatenate(parts)
