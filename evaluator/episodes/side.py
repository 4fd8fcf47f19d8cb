"""The recordings of one policy, and the episodes of them that count: the first K of every environment."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.episodes.clusters import Starts, clusters_of
from gpusimbench.evaluator.read.episodes import (
    At,
    EpisodeTable,
    episode_table,
    first_observations,
    has_episodes,
    has_rewards,
    successes,
)
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import NothingComparable, UsageError

_MOST_RETURN = 1e100  # squares of larger differences, of many episodes, may be no numbers


class Choice(Enum):
    """Where the number of episodes per environment comes from."""

    GIVEN = "given"
    LARGEST = "largest that every environment has"


@dataclass(frozen=True)
class Side:
    """Recordings of one policy, with their episodes; the environments of all recordings are numbered through."""

    recordings: tuple[Recording, ...]
    tables: tuple[EpisodeTable, ...]
    finished: NDArray[np.int64]
    """Episodes of each environment before its first that the task did not end, [env]."""
    repeats: tuple[Recording, ...] = ()
    """Recordings with the same bits as one of `recordings`, which do not count."""

    def envs_of(self, file: int) -> slice:
        """The environments of a recording, among all."""
        counts = np.cumsum([0, *(recording.configuration.n_env for recording in self.recordings)])
        return slice(int(counts[file]), int(counts[file + 1]))

    def place(self, env: int) -> str:
        """An environment in words."""
        file = next(i for i in range(len(self.recordings)) if env < self.envs_of(i).stop)
        return f"environment {env - self.envs_of(file).start} of {self.recordings[file].path}"

    @property
    def at_most(self) -> int:
        """The largest number of finished episodes that every environment has."""
        return int(self.finished.min())


@dataclass(frozen=True)
class Episodes:
    """The first K episodes of every environment, arrays of shape [env, episode].

    side       the recordings that they are of
    rows       of the tables of the recordings, a list a recording
    returns    [unit of the reward]
    lengths    [step]
    success    None where no flag was named
    terminated whether they ended so; the others were truncated
    starts     the first observation of each as bytes
    clusters   of each environment, [env]: environments that repeat each other have one number; see clusters.py
    began      first observations of the first episodes, a mapping a recording
    """

    side: Side
    rows: tuple[NDArray[np.int64], ...]
    returns: NDArray[np.float64]
    lengths: NDArray[np.int64]
    terminated: NDArray[np.bool_]
    success: NDArray[np.bool_] | None
    starts: NDArray[Any]
    clusters: NDArray[np.int64]
    began: tuple[Starts, ...]

    @cached_property
    def _of_clusters(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        # the first environment of each cluster, the place of each environment's cluster, and how many a cluster has
        return np.unique(self.clusters, return_index=True, return_inverse=True, return_counts=True)[1:]

    @property
    def n_cluster(self) -> int:
        """Environments without repeats."""
        return len(self.repeats)

    @property
    def repeats(self) -> NDArray[np.int64]:
        """Environments of each cluster, [cluster]."""
        return self._of_clusters[2]

    def by_cluster(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Means over the environments of each cluster, [cluster, ...], from values [env, ...]."""
        if self.n_cluster == self.n_env:
            return values.astype(np.float64)
        total = np.zeros((self.n_cluster, *values.shape[1:]))
        np.add.at(total, self._of_clusters[1], values)
        size = self.repeats.reshape(-1, *(1 for _ in values.shape[1:]))
        found: NDArray[np.float64] = total / size
        return found

    @property
    def cluster_starts(self) -> NDArray[Any]:
        """The starts of the first environment of each cluster, [cluster, episode]."""
        return np.asarray(self.starts[self._of_clusters[0]])

    @property
    def n_env(self) -> int:
        """Environments."""
        return len(self.returns)

    @property
    def per_env(self) -> int:
        """Episodes of each."""
        return int(self.returns.shape[1])


def read_side(recordings: Sequence[Recording]) -> Side:
    """The episodes of recordings.

    They have passed ``check_distinct``. NothingComparable where a recording has no episodes, or did not end well.
    """
    for recording in recordings:
        if not has_episodes(recording):
            raise NothingComparable(f"{recording.path} has no episodes; gpusimbench.wrap records them")
        if not has_rewards(recording):
            raise NothingComparable(f"{recording.path} has no rewards: its data set lacks them")
        if not recording.usable:
            why = "; ".join(filter(None, (recording.reason, *recording.dropouts)))
            raise NothingComparable(f"{recording.path} is {recording.status}: {why}")
    tables = tuple(map(episode_table, recordings))
    finished = [_finished(one.configuration.n_env, table) for one, table in zip(recordings, tables, strict=True)]
    return Side(tuple(recordings), tables, np.concatenate(finished))


def without_repeats(side: Side) -> Side:
    """The same without recordings whose state hashes are those of an earlier one at every captured step.

    A run that is repeated with the same seed, bit for bit, is no further sample of the policy: to count it again would
    make intervals and p-values too small. Recordings without state hashes are kept.
    """
    first: dict[bytes, int] = {}
    for file, recording in enumerate(side.recordings):
        found = recording.fingerprints("capture")
        bits = f"{file}".encode() if found is None else found.steps.tobytes() + found.hashes.tobytes()
        first.setdefault(hashlib.sha256(bits).digest(), file)
    kept = list(first.values())
    return replace(
        side,
        recordings=tuple(side.recordings[file] for file in kept),
        tables=tuple(side.tables[file] for file in kept),
        finished=np.concatenate([side.finished[side.envs_of(file)] for file in kept]),
        repeats=tuple(one for file, one in enumerate(side.recordings) if file not in kept),
    )


def check_distinct(recordings: Sequence[Recording]) -> None:
    """UsageError where recordings are of different tasks, or one is there twice."""
    scenes = {one.configuration.scene: one for one in recordings}
    if len(scenes) > 1:
        (first, one), (second, other) = list(scenes.items())[:2]
        raise UsageError(f"{one.path} is of {first} and {other.path} of {second}: one task is evaluated at a time")
    known: dict[str, Recording] = {}
    for recording in recordings:
        if twin := known.get(recording.content_hash):
            raise UsageError(f"{twin.path} and {recording.path} are the same recording")
        known[recording.content_hash] = recording


def _finished(n_env: int, table: EpisodeTable) -> NDArray[np.int64]:
    bounds = np.searchsorted(table.env, np.arange(n_env + 1))
    cut = np.append(np.flatnonzero(~table.ended), len(table.env))  # the first episode of each env that is not finished
    found: NDArray[np.int64] = np.minimum(cut[np.searchsorted(cut, bounds[:-1])], bounds[1:]) - bounds[:-1]
    return found


def choose(side: Side, per_env: int, success: str | None, at: At) -> Episodes:
    """The first `per_env` episodes of every environment.

    success  name of the flag that says whether an episode succeeded; None: nothing does

    NothingComparable where an environment has fewer, a return is too large to be compared, or the flag was not given;
    UsageError where there is no such flag.
    """
    short = np.flatnonzero(side.finished < per_env)
    if short.size:
        least = int(short[np.argmin(side.finished[short])])
        raise NothingComparable(
            f"{len(short)} of {len(side.finished)} environments have fewer than {per_env} finished episodes; "
            f"{side.place(least)} has the fewest, {side.finished[least]}. Record more steps, or ask for at most "
            f"{side.at_most} (--per-env). Leaving these environments out would leave out long episodes"
        )
    if per_env < 1:
        raise NothingComparable(f"no episode of {side.place(int(np.argmin(side.finished)))} ended: record more steps")
    n_envs = [recording.configuration.n_env for recording in side.recordings]
    rows = tuple(
        np.searchsorted(table.env, np.arange(n))[:, None] + np.arange(per_env)
        for n, table in zip(n_envs, side.tables, strict=True)
    )

    def column(value: Callable[[EpisodeTable], NDArray[Any]]) -> NDArray[Any]:
        return np.concatenate([value(table)[at] for table, at in zip(side.tables, rows, strict=True)])

    returns = column(lambda table: table.returns)
    if (beyond := ~(np.abs(returns) <= _MOST_RETURN)).any():  # also NaN
        env, episode = (int(i) for i in np.argwhere(beyond)[0])
        raise NothingComparable(
            f"the return of episode {episode} of {side.place(env)} is {returns[env, episode]:g}; only returns up to "
            f"{_MOST_RETURN:g} are evaluated"
        )
    flags = None
    if success is not None:
        of_all = zip(side.recordings, side.tables, rows, strict=True)
        flags = np.concatenate([successes(one, table, at_rows, success, at) for one, table, at_rows in of_all])
    seen = [_first_seen(*of) for of in zip(side.recordings, side.tables, rows, strict=True)]
    began = tuple({name: array[::per_env] for name, array in one.items()} for one in seen)
    return Episodes(
        side=side,
        rows=rows,
        returns=returns,
        lengths=column(lambda table: table.length),
        terminated=column(lambda table: table.terminated),
        success=flags,
        starts=np.concatenate([_starts(one, at.shape) for one, at in zip(seen, rows, strict=True)]),
        clusters=clusters_of(side.recordings, began),
        began=began,
    )


def with_common_clusters(groups: Sequence[Episodes]) -> list[Episodes]:
    """The same episodes, with numbers of clusters that hold in all groups: one may repeat environments of another."""
    recordings = [recording for one in groups for recording in one.side.recordings]
    found = clusters_of(recordings, [began for one in groups for began in one.began])
    ends = np.cumsum([one.n_env for one in groups])
    return [replace(one, clusters=part) for one, part in zip(groups, np.split(found, ends[:-1]), strict=True)]


def _first_seen(recording: Recording, table: EpisodeTable, rows: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    at = rows.ravel()
    seen = first_observations(recording, table.env[at], table.first_row[at])
    if not seen:
        raise NothingComparable(f"{recording.path} has no observations, by which episodes are told apart")
    return seen


def _starts(seen: dict[str, NDArray[Any]], shape: tuple[int, ...]) -> NDArray[Any]:
    parts = [np.ascontiguousarray(array).view(np.uint8) for array in seen.values()]
    joined = np.ascontiguousarray(np.concatenate(parts, axis=1))
    return joined.view(np.dtype((np.void, joined.shape[1])))[:, 0].reshape(shape)
