"""All episodes of a recording beside those of its replay."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.result import Setting
from gpusimbench.evaluator.diff.settings import UNSET, differing_settings
from gpusimbench.evaluator.read.episodes import (
    At,
    Episode,
    EpisodeTable,
    episode_table,
    episodes,
    has_episodes,
    successes,
)
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.replays.verdict import EpisodeVerdict, Judged, judge
from gpusimbench.evaluator.statistics.cases import wilson
from gpusimbench.schemas.errors import NothingComparable
from gpusimbench.schemas.vector import DATA_SET

_CAUSES = ("options.", "version", "dt", "software.", "host.cpu", "gpu")
_OF_FILES = ("options.", "dt")
"""What a data set says of itself; software and machine of its recording are those that read the data set."""

_ID = "options.env_id"

_NO_CAUSES = (
    "options.infos",
    "options.seeds",
    "options.autoreset_mode",
    "options.source",
    "options.not_given",
    "options.vectorization",
    "software.recorder",
    "software.packages.gpusimbench",
)


@dataclass(frozen=True)
class Share:
    """How many episodes have a verdict, and their share with Wilson's 95 % interval."""

    verdict: EpisodeVerdict
    episodes: int
    share: float
    ci95: tuple[float, float]


@dataclass(frozen=True)
class ReplayComparison:
    """A recording and its replay.

    original, replay  names of the files
    task       what was recorded
    episodes   in order of environments
    shares     of every verdict
    began_otherwise  episodes that were replayed, and whose first observations differ: there the environment, or its
                     seed, is another, and not its answers to actions
    settings   what may be the reason: versions, options and machine that the two files name differently
    of_data_set  whether the original was made of a data set, which names neither versions nor machine
    """

    original: str
    replay: str
    task: str
    episodes: tuple[Judged, ...]
    shares: tuple[Share, ...]
    began_otherwise: int
    settings: tuple[Setting, ...]
    of_data_set: bool = False

    def count(self, verdict: EpisodeVerdict) -> int:
        """Episodes with that verdict."""
        return sum(one.verdict is verdict for one in self.episodes)


def compare(
    original: Recording, replay: Recording, *, success: str | None, at: At, tolerance: float
) -> ReplayComparison:
    """Judge every episode of the original; see verdict.judge.

    success  name of the flag that says whether an episode succeeded; None where none is asked for

    NothingComparable where the original has no episodes.
    """
    if not has_episodes(original):
        raise NothingComparable(f"{original.path} has no episodes: gpusimbench.wrap records them")
    flags = []
    if success:
        steps = _steps_of_cut(original)
        flags = [successes_of(original, success, at), successes_of(replay, success, at, steps)]
    judged = []
    of_replay = _by_env(replay)
    number, replayed = next(of_replay, (-1, []))
    for env, group in _by_env(original):
        while -1 < number < env:
            number, replayed = next(of_replay, (-1, []))
        there = {one.number: one for one in replayed} if number == env else {}
        for episode in group:
            other = there.get(episode.number)
            key = (env, episode.number)
            of_both = (flags[0][key], flags[1][key]) if flags and other is not None else None
            judged.append(judge(episode, other, of_both, tolerance))
    if not judged:
        raise NothingComparable(f"{original.path} has no episode with a step")
    counts = Counter(one.verdict for one in judged)
    n = len(judged)
    of_data_set = original.configuration.simulator == DATA_SET
    causes = _OF_FILES if of_data_set else _CAUSES
    return ReplayComparison(
        original=str(original.path),
        replay=str(replay.path),
        task=original.configuration.scene,
        episodes=tuple(judged),
        shares=tuple(
            Share(verdict, counts[verdict], counts[verdict] / n, wilson(counts[verdict], n))
            for verdict in EpisodeVerdict
        ),
        began_otherwise=sum(one.verdict is not EpisodeVerdict.ABSENT and not one.began_alike for one in judged),
        settings=tuple(
            one
            for one in differing_settings(original, replay)
            if one.name.startswith(causes)
            and not one.name.startswith(_NO_CAUSES)
            and not (of_data_set and one.a == UNSET)  # which most data sets do not tell
            and not _same_task(one)
        ),
        of_data_set=of_data_set,
    )


def _same_task(setting: Setting) -> bool:
    """Whether two ids of Gymnasium's registry are of one task, though one of them names a module to import before."""
    return setting.name == _ID and setting.a.rpartition(":")[2] == setting.b.rpartition(":")[2]


def _by_env(recording: Recording) -> Iterator[tuple[int, list[Episode]]]:
    for env, group in groupby(episodes(recording), key=lambda episode: episode.env):
        yield env, list(group)


def _steps_of_cut(recording: Recording) -> dict[tuple[int, int], int]:
    """Steps of the episodes that the task did not end, by environment and number."""
    table = episode_table(recording)
    rows = np.flatnonzero(~table.ended)
    return dict(zip(_keys(table, rows), table.length[rows].tolist(), strict=True))


def successes_of(
    recording: Recording, name: str, at: At, steps: Mapping[tuple[int, int], int] | None = None
) -> dict[tuple[int, int], bool]:
    """Whether each episode succeeded, by environment and number; raises as successes of evaluator.episodes.

    steps  of episodes of which no more are looked at
    """
    table = episode_table(recording)
    rows = np.arange(len(table.env))
    keys = _keys(table, rows)
    ends = [
        min(last, first + (steps or {}).get(key, last))
        for key, first, last in zip(keys, table.first_row.tolist(), table.last_row.tolist(), strict=True)
    ]
    table = replace(table, last_row=np.array(ends, dtype=np.int64))
    return dict(zip(keys, successes(recording, table, rows, name, at).tolist(), strict=True))


def _keys(table: EpisodeTable, rows: NDArray[np.int64]) -> list[tuple[int, int]]:
    return list(zip(table.env[rows].tolist(), table.number[rows].tolist(), strict=True))
