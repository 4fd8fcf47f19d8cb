"""One policy recorded under several values of a setting: whether success or return depend on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gpusimbench.evaluator.episodes.comparison import LEAST, evenly_repeated
from gpusimbench.evaluator.episodes.outcome import RETURN, SUCCESS, Outcome, outcomes
from gpusimbench.evaluator.episodes.side import Episodes, with_common_clusters
from gpusimbench.evaluator.read.episodes import At
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.statistics.cases import APART, PERMUTATIONS, in_proportion
from gpusimbench.evaluator.statistics.families import holm
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.gathering import gathered

LEVEL = 0.05

_SEED = 0
_AT_ONCE = 10_000_000  # means of environments that are exchanged at a time


def _device(recording: Recording) -> str:
    return recording.simulation.device if recording.simulation else ""


KEYS: Mapping[str, Callable[[Recording], Any]] = {
    "n_env": lambda recording: recording.configuration.n_env,
    "device": _device,
    "version": lambda recording: recording.simulation.version if recording.simulation else "",
}
"""Settings by name, and what a recording has of each."""


@dataclass(frozen=True)
class Setting:
    """The recordings of one value."""

    value: str
    outcome: Outcome


@dataclass(frozen=True)
class Dependence:
    """Whether a quantity depends on the setting.

    name        "success" or "return"
    largest     difference of the means of two values, the highest minus the lowest
    p_value     that all values give the same: a permutation test with environments as units, of the sum over values of
                environments times the squared distance of their mean from the mean of all; over the variance of their
                values, where some values were recorded more often than others
    adjusted_p  by Holm, over the quantities
    paired      whether the same environments began alike under all values: each is exchanged with its repeats alone
    """

    name: str
    largest: float
    p_value: float
    adjusted_p: float
    paired: bool

    @property
    def depends(self) -> bool:
        """Whether chance does not explain it at the 5 % level."""
        return self.adjusted_p <= LEVEL


@dataclass(frozen=True)
class Across:
    """What a policy comes to under each value of a setting.

    key        of KEYS
    settings   in order of their values
    quantities success, if a flag was named, and return
    """

    key: str
    settings: tuple[Setting, ...]
    quantities: tuple[Dependence, ...]


def grouped(recordings: Sequence[Recording], key: str) -> dict[Any, list[Recording]]:
    """Recordings by their value of a setting, in its order; UsageError where there is one value alone."""
    found = gathered((KEYS[key](recording), recording) for recording in recordings)
    if len(found) < 2:
        raise UsageError(f"all recordings have one {key}, {next(iter(found))}: give recordings of two or more")
    return dict(sorted(found.items()))


def across(
    key: str, groups: Mapping[Any, Sequence[Recording]], per_env: int | None, success: str | None, at: At
) -> Across:
    """What a policy comes to in each group, and whether it depends on the setting.

    Arguments and errors as of `outcomes`; groups as of `grouped`.
    """
    episodes, found = outcomes(list(groups.values()), per_env, success, at)
    settings = tuple(Setting(str(value), one) for value, one in zip(groups, found, strict=True))
    return Across(key, settings, dependences(episodes))


def dependences(groups: Sequence[Episodes]) -> tuple[Dependence, ...]:
    """Whether quantities depend on the group; all groups have as many episodes per environment.

    Environments are taken to be independent, but for those that repeat each other; see clusters.py. Where all groups
    have the same environments, each is exchanged with its repeats alone. Where only some are in several groups, these
    make the groups nearer to each other than by chance, and p-values too large rather than too small.
    """
    common = with_common_clusters(groups)
    clusters = [np.unique(one.clusters) for one in common]
    paired = all(np.array_equal(one, clusters[0]) for one in clusters)
    even = paired or evenly_repeated(*common)
    flags = [one.by_cluster(one.success).mean(axis=1) for one in common if one.success is not None]
    found = [_dependence(SUCCESS, flags, paired=paired, even=even)] if len(flags) == len(groups) else []
    returns = [one.by_cluster(one.returns).mean(axis=1) for one in common]
    found.append(_dependence(RETURN, returns, paired=paired, even=even))
    adjusted = holm([one.p_value for one in found])
    return tuple(replace(one, adjusted_p=p) for one, p in zip(found, adjusted, strict=True))


def _dependence(
    name: str, by_env: Sequence[NDArray[np.float64]], *, paired: bool = False, even: bool = True
) -> Dependence:
    # paired  values of one place are of environments that began alike
    # even    all values are means over as many repeats; else groups spread otherwise, and their variances count
    means = [float(one.mean()) for one in by_env]
    p = _exchanged(by_env, paired=paired, even=even or min(map(len, by_env)) < 2)
    return Dependence(name, max(means) - min(means), p, p, paired)


def _exchanged(by_env: Sequence[NDArray[np.float64]], *, paired: bool, even: bool) -> float:
    whole = np.concatenate(by_env)
    if np.ptp(whole) == 0 or (paired and (len(whole) == len(by_env) or np.ptp(by_env, axis=0).max() == 0)):
        return 1.0
    # about the mean, which every arrangement has
    values = np.split(in_proportion(whole - whole.mean()), np.cumsum([len(one) for one in by_env])[:-1])

    def spread(*groups: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        means = np.array([one.mean(axis=axis) for one in groups])
        weights = np.array([np.full(means.shape[1:], one.shape[axis]) for one in groups])
        if not even:  # as Welch's t, of any number of groups
            weights = 1 / (LEAST + np.array([one.var(axis=axis, ddof=1) for one in groups]) / weights)
        centre = (weights * means).sum(axis=0) / weights.sum(axis=0)
        return np.asarray(APART + (weights * (means - centre) ** 2).sum(axis=0))

    tested = stats.permutation_test(
        values,
        spread,
        permutation_type="samples" if paired else "independent",
        alternative="greater",
        n_resamples=PERMUTATIONS,
        vectorized=True,
        batch=max(1, _AT_ONCE // len(whole)),
        rng=np.random.default_rng(_SEED),
    )
    return float(tested.pvalue)
