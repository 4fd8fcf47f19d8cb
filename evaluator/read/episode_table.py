"""Episodes of a recording as columns: which environment, from which row to which, how long, what return."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.vector import NOT_GIVEN

_FLAGS = ("terminated", "truncated")
NEEDED = ("reward", *_FLAGS, "stepped", "episode", "episode_step")
"""Fields, beside observations, without which a recording has no episodes."""

_ROWS = 50  # that are read at a time, as many as a block has


@dataclass(frozen=True)
class EpisodeTable:
    """Every episode with a step, in order of environments and then of time, arrays of shape [episode].

    env, number  of the environment, and of the episode in it, from 0
    first_row    of the recording: its first observation is there
    last_row     of its last step
    length       steps
    returns      sum of its rewards [unit of the reward]
    terminated, truncated  whether it ended so; neither where a reset, or the end of the recording, cut it
    """

    env: NDArray[np.int64]
    number: NDArray[np.int64]
    first_row: NDArray[np.int64]
    last_row: NDArray[np.int64]
    length: NDArray[np.int64]
    returns: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Whether the task ended it, [episode]."""
        return self.terminated | self.truncated


def has_episodes(recording: Recording) -> bool:
    """Whether a recording has what episodes are made of."""
    return {f"{ENV}/{name}" for name in NEEDED} <= {field.name for field in recording.fields}


def has_rewards(recording: Recording) -> bool:
    """Whether the rewards of a recording with episodes are known; zeros stand for those that a data set lacks."""
    return "reward" not in recording.configuration.options.get(NOT_GIVEN, "").split(", ")


def episode_table(recording: Recording) -> EpisodeTable:
    """The episodes of a recording that has some (has_episodes).

    DamagedRecording where an episode has a number that it cannot have.
    """
    arrays = [recording.state(ENV, name) for name in NEEDED]
    rows = min(len(array) for array in arrays)  # of a file that was cut short, some have more
    columns = {name: array[:rows, :, 0, 0] for name, array in zip(NEEDED, arrays, strict=True)}
    stepped = columns["stepped"][1:] != 0
    number = columns["episode"][:-1].astype(np.float64)
    if not ((number >= 0) & (number <= len(number)) & (number == np.floor(number))).all():
        raise DamagedRecording(f"{recording.path}: episodes are not numbered from 0 on, at most one a step")
    row, env = np.nonzero(stepped)
    key = env * (len(number) + 1) + number[stepped].astype(np.int64)
    episode, first, at = np.unique(key, return_index=True, return_inverse=True)  # the first step: rows come in order
    n = len(episode)
    rewards = columns["reward"][1:][stepped].astype(np.float64)
    last = np.zeros(n, dtype=np.int64)
    np.maximum.at(last, at, row + 1)
    flags = {flag: np.zeros(n, dtype=np.bool_) for flag in _FLAGS}
    for flag, of_episode in flags.items():
        of_episode[at[columns[flag][1:][stepped] != 0]] = True
    return EpisodeTable(
        env=episode // (len(number) + 1),
        number=episode % (len(number) + 1),
        first_row=row[first],
        last_row=last,
        length=np.bincount(at, minlength=n),
        returns=np.bincount(at, weights=rewards, minlength=n).astype(np.float64),
        **flags,
    )


def first_observations(recording: Recording, env: NDArray[np.int64], row: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
    """Observations in some rows of some environments, [episode, width] by the name of the array.

    env, row  of each, [episode], such as those of an EpisodeTable
    """
    names = [field.field for field in recording.fields if field.group == ENV and field.field.startswith("observation")]
    return rows_of(recording, names, env, row)


def rows_of(
    recording: Recording, names: Sequence[str], env: NDArray[np.int64], row: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Some rows of some arrays of environments, [episode, width] by the name of the array; see first_observations."""
    found = {}
    for name in names:
        array = recording.state(ENV, name)
        seen = np.empty((len(row), array.shape[3]), dtype=array.dtype)
        for begin in np.unique(row // _ROWS) * _ROWS:  # no block is read twice
            here = row // _ROWS == begin // _ROWS
            seen[here] = array[begin : begin + _ROWS, :, 0][row[here] - begin, env[here]]
        found[name] = seen
    return found
