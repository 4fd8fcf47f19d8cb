"""One episode and its replay: the same bits, the same outcome, or another outcome, and where they part."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.arrays import ArrayDivergence, Rows, compare_arrays
from gpusimbench.evaluator.read.episodes import Episode
from gpusimbench.schemas.vector import IMAGE_HASH

REWARD = "reward"


class EpisodeVerdict(Enum):
    """The verdict on an episode, strongest first.

    IDENTICAL  every observation and reward has the same bits, and the ends are the same
    SAME       bits differ; length, ends, success and, within a tolerance, the return are the same
    UNKNOWN    bits differ, the length is the same, and the original has neither rewards nor a success
    OTHER      length, ends, success or return differ
    ABSENT     the replay has no such episode
    """

    IDENTICAL = "bit-identical"
    SAME = "same outcome"
    UNKNOWN = "outcome not known"
    OTHER = "other outcome"
    ABSENT = "not replayed"


@dataclass(frozen=True)
class Largest:
    """The largest distance between two observations of a step that both have: of which array, at which step."""

    field: str
    step: int
    distance: float


@dataclass(frozen=True)
class Judged:
    """An episode and its replay; step k is what the k-th action led to, step 0 the reset.

    env, number    of the environment, and of the episode in it, from 0
    verdict        see EpisodeVerdict
    steps          of the original and of the replay
    returns        sums of the rewards of both [unit of the reward]; None where the original has no rewards
    ends           of both: "terminated", "truncated", or "cut" where something else ended it
    success        of both; None where no flag was named
    began_alike    whether the first observations have the same bits
    first          where bits differ first; None where they do not
    not_compared   a sentence for each array that only one has, or in another shape or dtype
    rounded        names of arrays that were compared in float32, since one of both has no more digits
    largest        distance of observations; None without one that is finite
    left_at        step at which the outcome left the original: the first at which one had ended, or at which the sums
                   of rewards were further apart than the tolerance; None where the outcome is the same
    """

    env: int
    number: int
    verdict: EpisodeVerdict
    steps: tuple[int, int]
    returns: tuple[float | None, float | None]
    ends: tuple[str, str]
    success: tuple[bool, bool] | None
    began_alike: bool
    first: ArrayDivergence | None
    not_compared: tuple[str, ...]
    rounded: tuple[str, ...]
    largest: Largest | None
    left_at: int | None


def judge(original: Episode, replay: Episode | None, success: tuple[bool, bool] | None, tolerance: float) -> Judged:
    """Compare an episode with its replay, which was fed the same actions.

    replay     None where there is none
    success    of both, None where no flag was named
    tolerance  how far returns may be apart, as a share of the sum of the absolute rewards of the original

    Where the original was cut, as by the end of the recording, its steps alone count.
    """
    if replay is None:
        return _absent(original)
    steps = min(len(original), len(replay))
    whole = not original.ended and len(replay) >= len(original)
    seen = steps + all(one.final_known or len(one) > steps for one in (original, replay))  # observations of both
    given = original.rewarded and replay.rewarded
    of_both, rounded = _rounded(*(_rows(one, steps, seen, rewarded=given) for one in (original, replay)))
    unlike = tuple(_unlike(*of_both))
    both = [name for name in of_both[0] if name not in dict(unlike)]
    compared = compare_arrays(*({name: rows[name] for name in both} for rows in of_both))
    ends = (_end(original), _end(original if whole else replay))
    lengths = (len(original), steps if whole else len(replay))
    rewards = tuple(
        one.rewards[:count].astype(np.float32 if REWARD in rounded else np.float64).astype(np.float64)
        for one, count in zip((original, replay), lengths, strict=True)
    )
    bound = tolerance * float(np.abs(rewards[0]).sum())
    returns = float(rewards[0].sum()), float(rewards[1].sum())
    same_end = lengths[0] == lengths[1] and ends[0] == ends[1]
    same_return = not given or bool(abs(returns[0] - returns[1]) <= bound) or returns[0] == returns[1]
    same_success = success is None or success[0] == success[1]
    same = same_end and same_return and same_success
    left = [
        *([] if same_end else [min(lengths[0], lengths[1])]),
        *([] if same_return else _apart(rewards[0][:steps], rewards[1][:steps], bound)),
        *([] if same_success else [lengths[0]]),
    ]
    identical = compared.identical and same and not unlike
    alike = EpisodeVerdict.SAME if given or success is not None else EpisodeVerdict.UNKNOWN
    return Judged(
        env=original.env,
        number=original.number,
        verdict=EpisodeVerdict.IDENTICAL if identical else alike if same else EpisodeVerdict.OTHER,
        steps=lengths,
        returns=returns if given else (None, None),
        ends=ends,
        success=success,
        began_alike=compared.first is None or compared.first.step > 0,
        first=replace(compared.first, env=original.env) if compared.first else None,
        not_compared=tuple(sentence for _, sentence in unlike),
        rounded=rounded,
        largest=_largest(*of_both, list(original.observations)),
        left_at=None if same else min(left, default=steps),
    )


def _absent(original: Episode) -> Judged:
    total = float(original.rewards.sum(dtype=np.float64)) if original.rewarded else None
    return Judged(
        env=original.env, number=original.number, verdict=EpisodeVerdict.ABSENT, steps=(len(original), 0),
        returns=(total, 0.0), ends=(_end(original), "cut"), success=None, began_alike=False, first=None,
        not_compared=(), rounded=(), largest=None, left_at=None,
    )  # fmt: skip


def _rows(episode: Episode, steps: int, seen: int, *, rewarded: bool) -> dict[str, Rows]:
    # with an axis of one environment, as arrays of recordings have it; actions come first, since they are causes
    return {
        **{name: Rows(array[:steps, np.newaxis], 1) for name, array in episode.actions.items()},
        **{name: Rows(array[:seen, np.newaxis]) for name, array in episode.observations.items()},
        **({REWARD: Rows(episode.rewards[:steps, np.newaxis], 1)} if rewarded else {}),
    }


def _rounded(a: dict[str, Rows], b: dict[str, Rows]) -> tuple[tuple[dict[str, Rows], dict[str, Rows]], tuple[str, ...]]:
    """Both with float64 rounded to float32 where the other has that, and the names of the arrays that were."""
    kinds = {np.dtype(np.float32), np.dtype(np.float64)}
    names = tuple(name for name in a if name in b and {a[name].values.dtype, b[name].values.dtype} == kinds)
    coarse = tuple(
        {**rows, **{name: Rows(rows[name].values.astype(np.float32), rows[name].first) for name in names}}
        for rows in (a, b)
    )
    return (coarse[0], coarse[1]), names


def _unlike(a: dict[str, Rows], b: dict[str, Rows]) -> Iterator[tuple[str, str]]:
    """Names of arrays that cannot be compared, each with a sentence."""
    for name in dict.fromkeys((*a, *b)):
        told = [
            f"{one[name].values[0, 0].size} x {one[name].values.dtype}" if name in one else "not there"
            for one in (a, b)
        ]
        if told[0] != told[1]:
            yield name, f"{name}: {told[0]} in the original, {told[1]} in the replay"


def _end(episode: Episode) -> str:
    words = [name for name in ("terminated", "truncated") if getattr(episode, name)]
    return " and ".join(words) or "cut"


def _apart(a: NDArray[np.float64], b: NDArray[np.float64], bound: float) -> list[int]:
    """The step at which sums of rewards pass the bound; empty where only what one has alone does."""
    beyond = np.flatnonzero(~(np.abs(np.cumsum(a) - np.cumsum(b)) <= bound))
    return [int(beyond[0]) + 1] if beyond.size else []


def _largest(a: dict[str, Rows], b: dict[str, Rows], names: list[str]) -> Largest | None:
    found: list[Largest] = []
    for name in (name for name in names if name in b and not name.endswith(IMAGE_HASH)):
        first, second = (rows[name].values.astype(np.float64) for rows in (a, b))
        if first.shape != second.shape:
            continue
        apart = np.abs(first - second).reshape(len(first), -1)
        apart = np.where(np.isfinite(apart), apart, 0.0)
        step, _ = np.unravel_index(np.argmax(apart), apart.shape) if apart.size else (0, 0)
        found.append(Largest(name, int(step), float(apart.max(initial=0.0))))
    return max(found, key=lambda one: one.distance, default=None)
