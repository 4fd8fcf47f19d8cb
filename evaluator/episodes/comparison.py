"""Two policies on the same task: differences of success and return, episode by episode where both began alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.episodes.outcome import RETURN, SUCCESS, error_of_mean, interval_of, shown
from gpusimbench.evaluator.episodes.side import Episodes
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.statistics.cases import (
    APART,
    FEWEST,
    PERMUTATIONS,
    ends_of,
    in_proportion,
    mcnemar,
    paired,
    resampled,
    standard_error,
)
from gpusimbench.evaluator.statistics.families import holm

LEVEL = 0.05

_SEED = 0

LEAST = 1e-6
"""Variance of a mean at least, of values whose largest is 1: means of equal values are not infinitely far apart."""


@dataclass(frozen=True)
class Pairs:
    """Which episodes of both policies belong together: the same number of the same environment.

    alike   pairs whose first observations are equal in every bit
    pairs   that there would be; 0 where the recordings have other numbers of environments
    """

    alike: int
    pairs: int

    @property
    def formed(self) -> bool:
        """Whether episodes are compared pair by pair: all of them began alike."""
        return self.pairs > 0 and self.alike == self.pairs


@dataclass(frozen=True)
class Discordant:
    """Pairs of which one episode succeeded: the first policy's alone, the second's alone."""

    only_first: int
    only_second: int


@dataclass(frozen=True)
class Difference:
    """The difference of a quantity: the first policy's mean minus the second's.

    ci95         by resampling environments
    p_value      two-sided, that the policies are alike
    adjusted_p   by Holm, over the quantities
    test         that gave it
    discordant   of success, where pairs are formed
    least_shown  smallest difference that this comparison would show with a probability of 80 % at the 5 % level
    """

    name: str
    unit: str
    difference: float
    ci95: tuple[float, float] | Missing
    p_value: float
    adjusted_p: float
    test: str
    discordant: Discordant | Missing
    least_shown: float | Missing

    @property
    def differs(self) -> bool:
        """Whether chance does not explain it at the 5 % level."""
        return self.adjusted_p <= LEVEL


@dataclass(frozen=True)
class Comparison:
    """Two policies compared: how episodes were paired, and the differences of all quantities."""

    pairs: Pairs
    differences: tuple[Difference, ...]


def compare(first: Episodes, second: Episodes) -> Comparison:
    """Compare two policies by as many episodes per environment."""
    pairs, even = pairs_of(first, second), evenly_repeated(first, second)
    differences = []
    if first.success is not None and second.success is not None:
        flags = (first.by_cluster(first.success), second.by_cluster(second.success))
        differences.append(_of_success(*flags, together=pairs.formed, even=even))
    returns = (first.by_cluster(first.returns), second.by_cluster(second.returns))
    differences.append(difference_of(RETURN, "unknown", *returns, together=pairs.formed, even=even))
    adjusted = holm([one.p_value for one in differences])
    return Comparison(
        pairs, tuple(replace(one, adjusted_p=p) for one, p in zip(differences, adjusted, strict=True))
    )  # fmt: skip


def pairs_of(first: Episodes, second: Episodes) -> Pairs:
    """Which episodes of two policies belong together; see Pairs. Repeats of an environment are in one pair."""
    starts = [side.cluster_starts for side in (first, second)]
    numbers = [_added(side) for side in (first, second)]
    if numbers[0] != numbers[1] or starts[0].dtype != starts[1].dtype:
        return Pairs(0, 0)
    return Pairs(int((starts[0] == starts[1]).sum()), starts[0].size)


def _added(side: Episodes) -> list[int]:
    """How many environments each recording adds that repeat none of an earlier one, where it adds any."""
    ends = [side.side.envs_of(file).stop for file in range(len(side.side.recordings))]
    known = [len(np.unique(side.clusters[:end])) for end in ends]
    return [number for number in np.diff([0, *known]).tolist() if number]


def _of_success(first: NDArray[np.float64], second: NDArray[np.float64], *, together: bool, even: bool) -> Difference:
    found = difference_of(SUCCESS, "1", first, second, together=together, even=even)
    if not together:
        return found
    if any((side % 1).any() for side in (first, second)):
        return replace(found, discordant=Missing("repeats of an environment have both outcomes"))
    discordant = Discordant(int((first > second).sum()), int((first < second).sum()))
    if first.shape[1] > 1:  # pairs of one environment are not independent
        return replace(found, discordant=discordant)
    p = mcnemar(discordant.only_first, discordant.only_second)
    return replace(found, p_value=p, test="McNemar, exact", discordant=discordant)


def difference_of(
    name: str, unit: str, first: NDArray[np.float64], second: NDArray[np.float64], *, together: bool, even: bool = True
) -> Difference:
    """The mean of the first policy minus that of the second, with environments as units.

    unit           of the values
    first, second  values of episodes, shape [env, episode]
    together       whether the episodes of one place are pairs
    even           whether all values are means over as many repeats, so that environments can be exchanged as they are
    """
    discordant = Missing("episodes are not paired" if name == SUCCESS else "of success alone")
    one, other = first.mean(axis=1), second.mean(axis=1)
    if together:
        found, error = paired(one, other, seed=_SEED), error_of_mean(first - second)
        return Difference(
            name, unit, found.mean, interval_of(found.ci95, error), found.p_value, found.p_value,
            "signs of differences exchanged by environment", discordant, shown(error, len(one) - 1),
        )  # fmt: skip
    p = _exchanged(one, other, even=even)
    error = _combined(error_of_mean(first), error_of_mean(second))
    return Difference(
        name, unit, float(one.mean() - other.mean()), interval_of(unpaired_interval(one, other), error), p, p,
        f"environments exchanged between policies{'' if even else ', Welch t'}", discordant,
        shown(error, len(one) + len(other) - 2),
    )  # fmt: skip


def _combined(first: float | Missing, second: float | Missing) -> float | Missing:
    if isinstance(first, Missing) or isinstance(second, Missing):
        return first if isinstance(first, Missing) else second
    return float(np.hypot(first, second))


def evenly_repeated(*groups: Episodes) -> bool:
    """Whether all environments of all groups have as many repeats."""
    return len(set(np.concatenate([one.repeats for one in groups]).tolist())) == 1


def _exchanged(one: NDArray[np.float64], other: NDArray[np.float64], *, even: bool) -> float:
    """p-value of the difference of two means, by a permutation test with environments as units.

    even  see difference_of; else the size of the difference is over its standard error, since a policy whose values are
          means over fewer repeats spreads more (Janssen 1997, studentized permutation tests)
    """
    from scipy import stats  # slow to load, and gsb-compare loads this module for all recordings

    together = np.concatenate([one, other])
    if np.ptp(together) == 0:
        return 1.0
    if min(len(one), len(other)) == 1:  # SciPy asks for two; the difference grows with the value that is alone
        alone = one[0] if len(one) == 1 else other[0]
        return float(min(1.0, 2 * min((together <= alone).mean(), (together >= alone).mean())))

    def difference(a: NDArray[np.float64], b: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        far = a.mean(axis=axis) - b.mean(axis=axis)
        if not even:
            far = np.abs(far) / np.sqrt(LEAST + sum(side.var(axis=axis, ddof=1) / side.shape[axis] for side in (a, b)))
        return np.asarray(APART + far)

    tested = stats.permutation_test(
        np.split(in_proportion(together - together.mean()), [len(one)]),
        difference,
        permutation_type="independent",
        alternative="two-sided" if even else "greater",
        n_resamples=PERMUTATIONS,
        vectorized=True,
        batch=max(1, 10_000_000 // (len(one) + len(other))),
        rng=np.random.default_rng(_SEED),
    )
    return float(tested.pvalue)


def unpaired_interval(one: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[float, float] | None:
    """95 % interval of the difference of the means of two samples, [env] each, by resampling both; see ends_of.

    None for fewer than FEWEST environments of either, and where neither spreads.
    """
    sizes = np.array([len(one), len(other)])
    if sizes.min() < FEWEST:
        return None
    squares = np.array([standard_error(side) for side in (one, other)], dtype=np.float64) ** 2
    total = float(squares.sum())
    if not total:
        return None
    first = resampled(lambda drawn: one[drawn].mean(axis=1), len(one), seed=_SEED)
    second = resampled(lambda drawn: other[drawn].mean(axis=1), len(other), seed=_SEED + 1)
    freedom = total**2 / float((squares**2 / (sizes - 1)).sum())  # Welch's
    return ends_of(first - second, freedom, (total / float((squares * (sizes - 1) / sizes).sum())) ** 0.5)
