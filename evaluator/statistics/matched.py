"""Variability against the number of environments, compared at one and the same number of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.jackknife import Interval, jackknife_mean, jackknife_pair_mean
from gpusimbench.evaluator.transport.points import in_canonical_order, planar_array

Points = npt.NDArray[np.float64]
Distance = Callable[[Points, Points], float]
"""Between two point sets [n, 2] and [m, 2]; in the unit of the points."""

MAX_POINTS = 2000
"""A side, for values at the full number of envs: exact transport between as many takes half a second, and ten runs have
45 pairs."""


@dataclass(frozen=True)
class Variability:
    """The variability at one number of envs, in the unit of the points.

    run_to_run  mean W1 over pairs of runs, with the interval over runs; None with one run
    parallel    mean W1 over pairs of envs, mean over runs, with the interval over runs; None with one env
    floor       mean W1 between two runs' envs dealt anew to two sides: what run_to_run is where runs differ no more
                than envs do; None with one run
    """

    run_to_run: Interval | None
    parallel: Interval | None
    floor: float | None


@dataclass(frozen=True)
class MatchedPoint:
    """The runs of one N_env.

    n_env, n_run        of the runs
    size                envs drawn of each
    matched             at that size, mean over draws
    run_to_run_draw_sd  standard deviation of the runs' mean over the draws: what the choice of envs makes of it, and no
                        part of the interval; None with one draw
    parallel_draw_sd    likewise
    n_draw              draws
    raw                 at n_env; or why not: that would be too many points
    """

    n_env: int
    n_run: int
    size: int
    matched: Variability
    run_to_run_draw_sd: float | None
    parallel_draw_sd: float | None
    n_draw: int
    raw: Variability | Missing


def matched_variability(
    runs: Mapping[int, npt.ArrayLike],
    distance: Distance,
    *,
    n_draw: int,
    seed: int,
    size: int | None = None,
    max_points: int = MAX_POINTS,
) -> tuple[MatchedPoint, ...]:
    """Variability of runs at several N_env, each reduced to the same number of envs.

    W1 between finite samples has a floor that falls with their size, so that the run-to-run variability at 16 envs and
    at 4096 are different quantities even of one law. Here every run is reduced to `size` envs, and the draws of all
    N_env are compared.

    In a draw all runs keep the same envs: identical runs have distance zero at any size, and what a run of `size` envs
    would show at the same places is what is estimated. Draws go through all envs before any comes again: a permutation
    is cut into N // size disjoint parts, then another. The parallel variability is a mean over pairs of envs, whose
    expectation does not depend on their number; it is given at both sizes to show that.

    Args:
        runs: by N_env, planar positions at the sample step relative to the envs' origins [any length unit], shape
            [n_run, n_env, n_item, 2].
        distance: between point sets; W1 for what is described here.
        n_draw: draws for each N_env larger than the size, at least 1; one where it is equal.
        seed: of the draws.
        size: envs to draw; the smallest N_env where left out.
        max_points: a side, beyond which raw values are not computed.

    Returns:
        one point for each N_env, in increasing order.

    Raises:
        ValueError: no runs, an N_env that is not the shape's, positions that are no such, a size that is not within
            1 and the smallest N_env, no draws.
    """
    found = {n: planar_array(positions, f"runs of {n} envs", ndim=4) for n, positions in sorted(runs.items())}
    for n, positions in found.items():
        if positions.shape[1] != n:
            raise ValueError(f"runs of {n} envs have {positions.shape[1]}")
    if not found or n_draw < 1:
        raise ValueError("at least one number of envs and one draw are needed")
    size = min(found) if size is None else size
    if not 1 <= size <= min(found):
        raise ValueError(f"size must be within 1 and the smallest number of envs, {min(found)}, got {size}")
    rng = np.random.default_rng(seed)
    return tuple(_point(p, distance, size, n_draw, max_points, rng) for p in found.values())


def draws(n_env: int, size: int, n_draw: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Which envs are drawn, shape [n_draw, size]; one draw of all where size is n_env."""
    if size == n_env:
        return np.arange(n_env)[np.newaxis]
    parts: list[npt.NDArray[np.int64]] = []
    whole = n_env // size
    while len(parts) < n_draw:
        cut = rng.permutation(n_env)[: whole * size].reshape(whole, size)
        parts += list(cut[rng.permutation(whole)])
    return np.stack(parts[:n_draw])


def _point(
    runs: Points, distance: Distance, size: int, n_draw: int, max_points: int, rng: np.random.Generator
) -> MatchedPoint:
    n_run, n_env, n_item = runs.shape[:3]
    drawn = draws(n_env, size, n_draw, rng)
    # one deal a draw for the floor, and as many where there is one draw of all
    each = [_matrices(runs[:, envs], distance, n_draw // len(drawn), rng) for envs in drawn]
    raw: Variability | Missing
    if size == n_env:
        raw = _variability(each)
    elif n_env * n_item <= max_points:
        raw = _variability([_matrices(runs, distance, n_draw, rng)])
    else:
        raw = Missing(f"{n_env * n_item} points a run are more than {max_points}")
    between = [float(m[np.triu_indices(n_run, 1)].mean()) for m, _, _ in each if m is not None]
    within = [float(p.mean()) for _, p, _ in each if p is not None]
    return MatchedPoint(n_env, n_run, size, _variability(each), _sd(between), _sd(within), len(drawn), raw)


_Found = tuple[Points | None, Points | None, float | None]


def _matrices(runs: Points, distance: Distance, n_deal: int, rng: np.random.Generator) -> _Found:
    """Between runs [run, run], within each run [run], and the mean over so many deals of two runs' envs."""
    n_run, n_env = runs.shape[:2]
    known = _Known(distance)
    within = None
    if n_env > 1:
        within = np.array([np.mean([known(run[i], run[j]) for i, j in combinations(range(n_env), 2)]) for run in runs])
    if n_run < 2:
        return None, within, None
    matrix = np.zeros((n_run, n_run))
    for i, j in combinations(range(n_run), 2):
        matrix[i, j] = matrix[j, i] = known(runs[i].reshape(-1, 2), runs[j].reshape(-1, 2))
    floors = []
    for _ in range(n_deal):
        pair = rng.choice(n_run, 2, replace=False)
        pool = runs[pair].reshape(2 * n_env, -1, 2)[rng.permutation(2 * n_env)]
        floors.append(known(pool[:n_env].reshape(-1, 2), pool[n_env:].reshape(-1, 2)))
    return matrix, within, float(np.mean(floors))


class _Known:
    """A distance that is computed once for the same two point sets, in whatever order of points."""

    def __init__(self, distance: Distance) -> None:
        self._distance = distance
        self._found: dict[tuple[bytes, bytes], float] = {}

    def __call__(self, a: Points, b: Points) -> float:
        a, b = in_canonical_order(a), in_canonical_order(b)
        one, other = sorted([a.tobytes(), b.tobytes()])
        if one == other:
            return 0.0
        if (one, other) not in self._found:
            self._found[one, other] = self._distance(a, b)
        return self._found[one, other]


def _variability(each: list[_Found]) -> Variability:
    matrices = [m for m, _, _ in each if m is not None]
    within = [p for _, p, _ in each if p is not None]
    floors = [f for _, _, f in each if f is not None]
    return Variability(
        _with_spread(jackknife_pair_mean(np.mean(matrices, axis=0))) if matrices else None,
        _with_spread(jackknife_mean(np.mean(within, axis=0))) if within else None,
        float(np.mean(floors)) if floors else None,
    )


def _with_spread(interval: Interval) -> Interval:
    # one of width zero would claim that rare differences are excluded
    if interval.standard_error != 0:
        return interval
    return replace(interval, ci95=Missing("the runs do not differ"), standard_error=None)


def _sd(values: list[float]) -> float | None:
    return float(np.std(values, ddof=1)) if len(values) > 1 else None
