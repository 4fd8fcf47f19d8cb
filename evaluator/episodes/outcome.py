"""What episodes of one policy come to: success, return and its profiles, and what stopping early would have said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.episodes.side import Choice, Episodes, choose, read_side, without_repeats
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.episodes import At, EpisodeTable, successes
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.statistics.cases import (
    FEWEST,
    interquartile_mean,
    interval_over_cases,
    least_shown,
    mean_interval,
    rate_interval,
    rows_differ,
    standard_error,
)

POWER = 0.8
"""Of the smallest differences that are printed."""

_ROUNDING = 1e-12

SUCCESS, RETURN = "success", "return"
_FEW = Missing(f"fewer than {FEWEST} environments")
_ALIKE = Missing("all environments have the same mean")

_THRESHOLDS = 51


@dataclass(frozen=True)
class FinishOrder:
    """The mean over the episodes that finished first, as many of each recording as count.

    difference  of it from the mean over as many episodes of every environment
    ci95        of the difference, by resampling environments
    biased      whether the interval leaves out 0
    """

    mean: float
    difference: float
    ci95: tuple[float, float] | Missing
    biased: bool


@dataclass(frozen=True)
class Quantity:
    """A quantity of episodes, "success" (a share) or "return".

    mean         over episodes, all environments having as many
    ci95         of it
    method       of the interval
    iqm          mean without the lowest and the highest quarter of the episodes
    iqm_ci95     of it, by resampling environments
    least_shown  smallest difference from another policy's mean that so many episodes of each would show with a
                 probability of 80 % at the 5 % level, if its spread is the same and no pairs are formed
    finish_order what stopping at the first finished episodes would have said
    env_p        p-value that environments are alike; a small one says that episodes depend on the environment
    number_p     p-value that the first, second, ... episodes of environments are alike
    """

    name: str
    unit: str
    mean: float
    ci95: tuple[float, float] | Missing
    method: str
    iqm: float | Missing
    iqm_ci95: tuple[float, float] | Missing
    least_shown: float | Missing
    finish_order: FinishOrder
    env_p: float | Missing
    number_p: float | Missing


@dataclass(frozen=True)
class Outcome:
    """The outcome of one policy.

    files          recordings
    repeats        recordings that are left out, because their bits are those of one of `files`
    scene          task
    n_env          environments of all recordings
    clusters       of these, without repeats of a seed; each counts as one environment, and its repeats are averaged
    n_envs         environments of a recording: the different numbers, ascending
    per_env        episodes of each that count: its first ones
    chosen         where per_env comes from
    success        name of the flag; None where none was named
    success_at     where it counts
    episodes       n_env * per_env
    n_left_out     episodes that finished and do not count
    terminated     of those that count; the others were truncated
    mean_length    of those that count [step]
    distinct_starts  different first observations among those of environments without repeats
    quantities     success, if a flag was named, and return
    """

    files: tuple[str, ...]
    repeats: tuple[str, ...]
    scene: str
    n_env: int
    clusters: int
    n_envs: tuple[int, ...]
    per_env: int
    chosen: Choice
    success: str | None
    success_at: At
    episodes: int
    n_left_out: int
    terminated: int
    mean_length: float
    distinct_starts: int
    quantities: tuple[Quantity, ...]


def outcomes(
    groups: Sequence[Sequence[Recording]], per_env: int | None, success: str | None, at: At
) -> tuple[list[Episodes], list[Outcome]]:
    """The episodes of groups of recordings, equally many of every environment, and what each group comes to.

    per_env  None: the largest number that every environment of all groups has

    Raises as `read_side` and `choose`.
    """
    sides = [without_repeats(read_side(recordings)) for recordings in groups]
    chosen = Choice.GIVEN if per_env else Choice.LARGEST
    per_env = per_env or min(side.at_most for side in sides)
    episodes = [choose(side, per_env, success, at) for side in sides]
    return episodes, [outcome(one, chosen, success, at) for one in episodes]


def outcome(episodes: Episodes, chosen: Choice, success: str | None, at: At) -> Outcome:
    """The outcome of the first episodes of every environment."""
    side = episodes.side
    first = tuple(
        _first_finished(table, int(rows.size)) for table, rows in zip(side.tables, episodes.rows, strict=True)
    )
    quantities = [_return(episodes, first)]
    if episodes.success is not None and success is not None:
        quantities.insert(0, _success(episodes, episodes.success, first, success, at))
    return Outcome(
        files=tuple(str(recording.path) for recording in side.recordings),
        repeats=tuple(str(recording.path) for recording in side.repeats),
        scene=side.recordings[0].configuration.scene,
        n_env=episodes.n_env,
        clusters=episodes.n_cluster,
        n_envs=tuple(sorted({recording.configuration.n_env for recording in side.recordings})),
        per_env=episodes.per_env,
        chosen=chosen,
        success=success,
        success_at=at,
        episodes=episodes.returns.size,
        n_left_out=int(sum(table.ended.sum() for table in side.tables)) - episodes.returns.size,
        terminated=int(episodes.terminated.sum()),
        mean_length=float(episodes.lengths.mean()),
        distinct_starts=len(np.unique(episodes.cluster_starts)),
        quantities=tuple(quantities),
    )


def interval_of(interval: tuple[float, float] | None, error: float | Missing) -> tuple[float, float] | Missing:
    """An interval by resampling, or why there is none: that of equal values has no width, whatever comes next."""
    return _ALIKE if error == 0 else interval or _FEW


def shown(error: float | Missing, freedom: float) -> float | Missing:
    """The smallest difference that is shown with a probability POWER, from its standard error; see least_shown."""
    if isinstance(error, Missing):
        return error
    return least_shown(error, POWER, freedom) if error else _ALIKE


def error_of_mean(values: NDArray[np.float64]) -> float | Missing:
    """Standard error of the mean of values [env, episode] whose environments are independent."""
    error = standard_error(values.mean(axis=1))
    return Missing("there is one environment") if error is None else error


def _success(
    episodes: Episodes, flags: NDArray[np.bool_], first: tuple[NDArray[np.int64], ...], name: str, at: At
) -> Quantity:
    side = episodes.side
    of_first = [
        successes(one, table, rows, name, at).astype(np.float64)
        for one, table, rows in zip(side.recordings, side.tables, first, strict=True)
    ]
    values = episodes.by_cluster(flags)
    several = episodes.per_env > 1
    widened = ", or resampled environments where they differ more" if several and len(values) >= FEWEST else ""
    return Quantity(
        name=SUCCESS,
        unit="1",
        mean=float(values.mean()),
        ci95=rate_interval(values),
        method=f"Wilson{widened}",
        iqm=Missing("of a flag it would say nothing"),
        iqm_ci95=Missing("of a flag it would say nothing"),
        least_shown=_least_of_two(values),
        finish_order=_finish_order(episodes, values, first, of_first),
        **_alike(values),
    )


def _return(episodes: Episodes, first: tuple[NDArray[np.int64], ...]) -> Quantity:
    values = episodes.by_cluster(episodes.returns)
    error = error_of_mean(values)

    def iqm_of(drawn: NDArray[np.int64]) -> NDArray[np.float64]:
        return interquartile_mean(values[drawn].reshape(len(drawn), -1))

    of_first = [table.returns[rows] for table, rows in zip(episodes.side.tables, first, strict=True)]
    return Quantity(
        name=RETURN,
        unit="unknown",
        mean=float(values.mean()),
        ci95=interval_of(mean_interval(values.mean(axis=1)), error),
        method="resampled environments",
        iqm=float(interquartile_mean(values.ravel())),
        iqm_ci95=interval_of(interval_over_cases(iqm_of, len(values)), error),
        least_shown=_least_of_two(values),
        finish_order=_finish_order(episodes, values, first, of_first),
        **_alike(values),
    )


def _alike(values: NDArray[np.float64]) -> dict[str, float | Missing]:
    if values.shape[1] < 2:
        alone = Missing("there is one episode of each environment")
        return {"env_p": alone, "number_p": alone}
    return {"env_p": rows_differ(values), "number_p": rows_differ(values.T)}


def _least_of_two(values: NDArray[np.float64]) -> float | Missing:
    error = error_of_mean(values)
    return shown(error if isinstance(error, Missing) else 2**0.5 * error, 2 * (len(values) - 1))


def _first_finished(table: EpisodeTable, number: int) -> NDArray[np.int64]:
    """Rows of the table of the episodes that finished first; those of one step in the order of environments."""
    ended = np.flatnonzero(table.ended)
    order = np.lexsort((table.env[ended], table.last_row[ended]))
    found: NDArray[np.int64] = ended[order[:number]]
    return found


def _finish_order(
    episodes: Episodes,
    values: NDArray[np.float64],
    first: tuple[NDArray[np.int64], ...],
    of_first: list[NDArray[np.float64]],
) -> FinishOrder:
    # of each cluster, per environment: how many of its episodes are among the first, and the sum of their values
    side = episodes.side
    envs = np.concatenate(
        [table.env[rows] + side.envs_of(i).start for i, table, rows in zip(count(), side.tables, first, strict=False)]
    )
    n_env = episodes.n_env
    number = episodes.by_cluster(np.bincount(envs, minlength=n_env))
    total = episodes.by_cluster(np.bincount(envs, weights=np.concatenate(of_first), minlength=n_env))
    by_env, largest = values.mean(axis=1), np.abs(values).max()

    def difference(drawn: NDArray[np.int64]) -> NDArray[np.float64]:
        counted = number[drawn].sum(axis=1)
        early = total[drawn].sum(axis=1) / np.where(counted > 0, counted, 1)
        found = early - by_env[drawn].mean(axis=1)
        # of none that finished, nothing is known; equal values have means that differ by rounding
        return np.where((counted > 0) & (np.abs(found) > _ROUNDING * largest), found, 0.0)

    ci95 = interval_over_cases(difference, len(values)) or _FEW
    return FinishOrder(
        mean=float(total.sum() / number.sum()),
        difference=float(difference(np.arange(len(values))[np.newaxis])[0]),
        ci95=ci95,
        biased=not isinstance(ci95, Missing) and not ci95[0] <= 0 <= ci95[1],
    )


@dataclass(frozen=True)
class Profile:
    """Of one policy (Agarwal et al. 2021, "score distributions"), a number for each threshold.

    share      of episodes with a larger return
    low, high  95 % interval at each threshold, by resampling environments; None for fewer than 8 environments
    """

    share: tuple[float, ...]
    low: tuple[float, ...] | None
    high: tuple[float, ...] | None


@dataclass(frozen=True)
class Profiles:
    """Profiles of policies, at the same thresholds.

    thresholds  from the smallest return to the largest [unit of the reward]
    """

    thresholds: tuple[float, ...]
    policies: tuple[Profile, ...]


def profiles(sides: Sequence[Episodes]) -> Profiles:
    """The profiles of policies, in their order."""
    returns = np.concatenate([side.returns.ravel() for side in sides])
    thresholds = np.linspace(returns.min(), returns.max(), _THRESHOLDS)
    return Profiles(tuple(thresholds.tolist()), tuple(_profile(side, thresholds) for side in sides))


def _profile(side: Episodes, thresholds: NDArray[np.float64]) -> Profile:
    by_env = side.by_cluster((side.returns[:, :, None] > thresholds).mean(axis=1))  # [cluster, threshold]
    bands = [mean_interval(column) for column in by_env.T]
    known = [band for band in bands if band is not None]
    low, high = (tuple(band[end] for band in known) or None for end in (0, 1))
    return Profile(tuple(by_env.mean(axis=0).tolist()), low, high)
