"""Whether noise accumulates as parallelisation increases: variability of a sweep at one and the same number of envs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluator.mapping import Mapper
from evaluator.metrics.variability import CM_PER_M
from evaluator.statistics.matched import MatchedPoint, matched_variability
from evaluator.sweeps import Sweep
from evaluator.transport.pair import wasserstein1
from evaluator.work import Work

_DRAWS = 10
_SEED = 0
_MAX_POINTS = 2000  # a side: each distance then takes a fraction of a second, and there are hundreds


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
    """Of the sweeps that have positions at two numbers of envs or more.

    planar  positions at the sample step [m] by label of the group, shape [run, env, item, 2]
    """
    found = []
    for sweep in sweeps:
        at = {p.n_env: runs for p in sweep.points if (runs := planar.get(p.result.label)) is not None}
        if len(at) < 2:
            continue
        items = next(iter(at.values())).shape[2]
        size = max(1, min(*at, _MAX_POINTS // items))
        points = work.once(_matched, [[n, runs * CM_PER_M] for n, runs in sorted(at.items())], size)
        found.append(Accumulation(sweep.label, sweep.key.scene, size, _DRAWS, _SEED, tuple(points)))
    return tuple(found)


def _matched(runs: list[tuple[int, NDArray[np.float64]]], size: int, _: Mapper) -> list[MatchedPoint]:
    by_number = dict(runs)
    return list(matched_variability(by_number, _distance, n_draw=_DRAWS, seed=_SEED, size=size, max_points=_MAX_POINTS))


def _distance(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return wasserstein1(a, b, alike=True).value
