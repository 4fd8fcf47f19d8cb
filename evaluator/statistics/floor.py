"""How far two samples of one law lie apart: W1 and energy distance with whole environments exchanged at random."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.mapping import Mapper
from gpusimbench.evaluator.metrics.variability import CM_PER_M
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.energy import EnergyDistance, energy_distance
from gpusimbench.evaluator.statistics.permutation import PermutationFloor, permutation_floor

_SEED = 0

_PERMUTATIONS = ((1000, 99), (2000, 19))
"""Permutations by the number of points a side: one distance costs about n^2.5, and a table should take seconds."""

_ENERGY_PERMUTATIONS = 999
_ENERGY_POINTS = 20_000
"""Of both sides: their distances are some four seconds of computing."""


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
