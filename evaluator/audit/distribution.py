"""Do originals and replays follow one law? A permutation test that exchanges runs, or environments.

Which of them may be exchanged decides what a p-value means. Runs are independent of each other: they are separate
processes. Environments of a run are not, where they are copies of each other, or where an environment's number decides
what happens in it: then exchanging them counts one draw many times, and rejects what is the same. So runs are exchanged
where there are enough of them for the test to be able to reject. Otherwise environments are, but only where each is a
draw of its own as far as the positions can show; and where that is not so, nothing is decided.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.identity import bitwise_classes
from gpusimbench.evaluator.metrics.variability import CM_PER_M
from gpusimbench.evaluator.statistics.permutation import arrangements, exhaustive_floor, permutation_floor

ALPHA = 0.05
"""A p-value up to this rejects one law."""

PERMUTATIONS = 199
"""Exchanges that are drawn where there are more than MOST_ARRANGEMENTS."""

MOST_ARRANGEMENTS = 400
"""Up to so many are all looked at: of few, a draw meets the observed one so often that nothing can be rejected."""

_MOST_RUNS = 1000

Runs = Sequence[npt.NDArray[np.float64]]


class Unit(Enum):
    """What is exchanged, and so what counts as one draw."""

    RUNS = "runs"
    ENVIRONMENTS = "environments"


_MOST_POINTS = {Unit.RUNS: 864, Unit.ENVIRONMENTS: 432}
"""On the larger side: one distance costs about n^2.5, an audit should take seconds, and runs have few arrangements."""


@dataclass(frozen=True)
class LawTest:
    """A test of one law.

    time             simulated time of the positions [s]
    unit             what was exchanged
    originals        how many of them on the side of the originals
    replays          and on that of the replays
    envs_per_run     environments that were used of each run, of `envs`; drawn with `seed`
    envs             environments of a run
    observed_cm      W1 between all planar positions of the two sides [cm]
    floor_q95_cm     95 % quantile of W1 after exchange [cm]
    p_value          chance of a W1 this large under one law
    least_p          smallest p-value that so many can give
    n_permutation    exchanges that were looked at
    exhaustive       whether these are all that there are; otherwise they were drawn
    seed             of what was drawn
    """

    time: float
    unit: Unit
    originals: int
    replays: int
    envs_per_run: int
    envs: int
    observed_cm: float
    floor_q95_cm: float
    p_value: float
    least_p: float
    n_permutation: int
    exhaustive: bool
    seed: int

    @property
    def rejects(self) -> bool:
        """Whether the two sides follow different laws, at level ALPHA."""
        return self.p_value <= ALPHA

    @property
    def can_reject(self) -> bool:
        """Whether so few could have shown a difference at all; where not, a large p-value says nothing."""
        return self.least_p <= ALPHA


def same_law(originals: Runs, replays: Runs, *, time: float, seed: int = 0) -> LawTest:
    """Test whether runs on both sides come from one law, by W1 between their planar positions.

    originals, replays  planar positions of each run [m], shape [env, item, 2], the same for all runs; at least one each
    time                simulated time that they are of [s]

    ValueError as of evaluator.statistics.permutation.
    """
    unit = exchangeable(originals, replays)
    envs = originals[0].shape[0]
    used = _drawn(originals, replays, _MOST_POINTS[unit], seed)
    a, b = (np.stack([run[used] for run in side]) * CM_PER_M for side in (originals, replays))
    points = a.shape[2] if unit is Unit.ENVIRONMENTS else len(used) * a.shape[2]
    a, b = a.reshape(-1, points, 2), b.reshape(-1, points, 2)
    exhaustive = arrangements(len(a), len(b)) <= MOST_ARRANGEMENTS
    found = exhaustive_floor(a, b) if exhaustive else permutation_floor(a, b, n_permutation=PERMUTATIONS, seed=seed)
    return LawTest(
        time=time,
        unit=unit,
        originals=len(a),
        replays=len(b),
        envs_per_run=len(used),
        envs=envs,
        observed_cm=found.observed,
        floor_q95_cm=found.floor_q95,
        p_value=found.p_value,
        least_p=least_p(len(a), len(b)),
        n_permutation=found.n_permutation,
        exhaustive=exhaustive,
        seed=seed,
    )


def exchangeable(originals: Runs, replays: Runs) -> Unit:
    """What may be exchanged between runs of positions [env, item, 2].

    Runs where they are enough for the test to reject at level ALPHA, and wherever environments are no draws of their
    own: two environments of a run are equal, or an environment is equal to the one of its number in another run.
    """
    if least_p(len(originals), len(replays)) <= ALPHA:
        return Unit.RUNS
    runs = np.stack([*originals, *replays])
    classes = bitwise_classes(runs.reshape(-1, *runs.shape[2:])).reshape(runs.shape[:2])
    alone = all(len(set(run)) == len(run) for run in classes)
    by_number = any(len(set(column)) < len(column) for column in classes.T)
    return Unit.ENVIRONMENTS if alone and not by_number and runs.shape[1] > 1 else Unit.RUNS


def least_p(a: int, b: int) -> float:
    """Smallest p-value of a permutation test of a against b units: W1 is the same with the sides exchanged."""
    count = arrangements(a, b)
    return 1 / (count if count <= MOST_ARRANGEMENTS else 1 + PERMUTATIONS)


def runs_needed(originals: int) -> int:
    """Fewest replays with which the test can reject by runs."""
    return next(count for count in range(1, _MOST_RUNS) if least_p(originals, count) <= ALPHA)


def _drawn(originals: Runs, replays: Runs, points: int, seed: int) -> npt.NDArray[np.int64]:
    # the same environments of every run, so that what depends on an environment's number is on both sides
    envs, items = originals[0].shape[:2]
    most = max(1, points // (items * max(len(originals), len(replays))))
    if envs <= most:
        return np.arange(envs)
    return np.sort(np.random.default_rng(seed).choice(envs, size=most, replace=False))
