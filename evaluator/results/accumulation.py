"""Whether noise accumulates as parallelisation increases: variability of a sweep at one and the same number of envs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.mapping import Mapper
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.variability import CM_PER_M
from gpusimbench.evaluator.results.sweeps import Sweep
from gpusimbench.evaluator.statistics.matched import MatchedPoint, matched_variability
from gpusimbench.evaluator.transport.pair import wasserstein1

_DRAWS = 5
_SEED = 0
_MIN_ENVS = 4  # fewer say next to nothing, and all others would be reduced to them
_MAX_POINTS = 500  # of a side that runs are reduced to: a distance takes 10 ms, and there are hundreds
_MAX_RAW_POINTS = 1000  # of a side as it is


@dataclass(frozen=True)
class Accumulation:
    """Variability against N_env of one sweep, in cm.

    label  of the sweep
    scene  its name
    size   envs that every run was reduced to
    draws  of those envs, at each N_env that is larger
    seed   of the draws
    points in order of N_env
    """

    label: str
    scene: str
    size: int
    draws: int
    seed: int
    points: tuple[MatchedPoint, ...]


def accumulations(
    sweeps: Sequence[Sweep], planar: Mapping[str, NDArray[np.float64] | None], work: Work
) -> tuple[Accumulation, ...]:
    """Of the sweeps that have positions of several runs at two numbers of envs or more, not counting those below 4.

    planar  positions at the sample step [m] by label of the group, shape [run, env, item, 2]
    """
    found = []
    for sweep in sweeps:
        found_at = {p.n_env: planar.get(p.result.label) for p in sweep.points if p.n_env >= _MIN_ENVS}
        at = {n_env: runs for n_env, runs in found_at.items() if runs is not None and len(runs) > 1}
        if len(at) < 2:
            continue
        items = next(iter(at.values())).shape[2]
        size = max(1, min(*at, _MAX_POINTS // items))
        points = work.once(_matched, [[n, runs * CM_PER_M] for n, runs in sorted(at.items())], size)
        found.append(Accumulation(sweep.label, sweep.key.scene, size, _DRAWS, _SEED, tuple(points)))
    return tuple(found)


def _matched(runs: list[tuple[int, NDArray[np.float64]]], size: int, _: Mapper) -> list[MatchedPoint]:
    by_number = dict(runs)
    return list(
        matched_variability(by_number, _distance, n_draw=_DRAWS, seed=_SEED, size=size, max_points=_MAX_RAW_POINTS)
    )


def _distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return wasserstein1(a, b, alike=True).value
