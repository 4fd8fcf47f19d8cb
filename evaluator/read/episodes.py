"""Episodes of recorded environments: what happened between two resets, whichever way made, as columns; and whether they
succeeded."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable, UsageError
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.vector import FINAL_GIVEN, NOT_GIVEN

_FLAGS = ("terminated", "truncated")

NEEDED = ("reward", *_FLAGS, "stepped", "episode", "episode_step")
"""Fields, beside observations, without which a recording has no episodes."""

_ROWS = 50  # that are read at a time, as many as a block has

_INFO, _GIVEN = "info_", "_given"


@dataclass(frozen=True)
class Episode:
    """One episode of one environment, of T steps.

    env, number   of the environment, and of the episode in it, from 0
    observations  by name, [T + 1, ...] as recorded: of the reset, and of every step, the last one included
    actions       by name, [T, ...]
    rewards       [T]
    terminated, truncated  whether it ended so; neither where it was cut by a reset, or by the end of the recording
    final_known   whether the last observation is known; that of a data set which lacks it repeats the one before
    rewarded      whether rewards are known; zeros stand for those of a data set which lacks them
    """

    env: int
    number: int
    observations: dict[str, NDArray[Any]]
    actions: dict[str, NDArray[Any]]
    rewards: NDArray[np.floating]
    terminated: bool
    truncated: bool
    final_known: bool = True
    rewarded: bool = True

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def ended(self) -> bool:
        """Whether the task ended it."""
        return self.terminated or self.truncated


@dataclass(frozen=True)
class EpisodeCounts:
    """Episodes of all environments.

    steps        that were made
    terminated, truncated  episodes that ended so; both where both flags were set
    ended        episodes that the task ended
    cut          episodes with a step that it did not: a reset, or the end of the recording, cut them
    mean_length  of those that ended [step]; None where none did
    mean_return  sum of their rewards, mean [unit of the reward]; None where none ended
    """

    steps: int
    terminated: int
    truncated: int
    ended: int
    cut: int
    mean_length: float | None
    mean_return: float | None


def episodes(recording: Recording) -> Iterator[Episode]:
    """The episodes of every environment in order of environments; those without a step are left out.

    Read one environment at a time. DamagedRecording where episodes are not numbered as they are recorded.
    """
    names = [field.field for field in recording.fields if field.group == ENV]
    for env in range(recording.configuration.n_env):
        yield from _of_env(recording, env, names)


def count_episodes(recording: Recording) -> EpisodeCounts | None:
    """How many episodes there are, and how long they were; None where a recording has none to count.

    DamagedRecording where an episode has a number that it cannot have.
    """
    if not has_episodes(recording):
        return None
    table = episode_table(recording)
    ended = table.ended
    n_ended = int(np.count_nonzero(ended))
    return EpisodeCounts(
        steps=int(table.length.sum()),
        terminated=int(np.count_nonzero(table.terminated)),
        truncated=int(np.count_nonzero(table.truncated)),
        ended=n_ended,
        cut=len(ended) - n_ended,
        mean_length=float(table.length[ended].mean()) if n_ended else None,
        mean_return=float(table.returns[ended].mean()) if n_ended and has_rewards(recording) else None,
    )


def _of_env(recording: Recording, env: int, names: list[str]) -> Iterator[Episode]:
    arrays = {name: recording.state(ENV, name) for name in names}
    rows_of_all = min(len(array) for array in arrays.values())
    columns = {name: array[:rows_of_all, env, 0] for name, array in arrays.items()}
    stepped = np.flatnonzero(columns["stepped"][1:, 0]) + 1  # rows that a step led to, each from the row before it
    if not stepped.size:
        return
    numbers = columns["episode"][stepped - 1, 0]
    starts = np.flatnonzero(np.diff(numbers, prepend=numbers[0] - 1))
    for begin, end in zip(starts, [*starts[1:], len(stepped)], strict=True):
        rows = stepped[begin:end]
        at = columns["episode_step"][rows - 1, 0]
        if (np.diff(rows) != 1).any() or (at != np.arange(len(rows))).any():
            raise DamagedRecording(f"{recording.path}: the steps of an episode of environment {env} are not in order")
        last = rows[-1]
        yield Episode(
            env=env,
            number=int(numbers[begin]),
            observations={
                name: np.concatenate([array[rows[:1] - 1], columns[f"final_{name}"][rows]])
                for name, array in columns.items()
                if name.startswith("observation") and f"final_{name}" in columns
            },
            actions={name: array[rows] for name, array in columns.items() if name.startswith("action")},
            rewards=columns["reward"][rows, 0],
            **{flag: bool(columns[flag][last, 0]) for flag in _FLAGS},
            rewarded=has_rewards(recording),
            final_known=FINAL_GIVEN not in columns or bool(columns[FINAL_GIVEN][last, 0]),
        )


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


class At(Enum):
    """At which of its steps the flag of an episode counts.

    LAST  at the last alone: "success at end"
    ANY   at any: "success once"
    """

    LAST = "last"
    ANY = "any"


def successes(
    recording: Recording, table: EpisodeTable, rows: NDArray[np.int64], name: str, at: At
) -> NDArray[np.bool_]:
    """Whether episodes succeeded, in the shape of `rows`.

    rows  of the table
    name  of an info, such as "success", or of another array of one number, such as "terminated"

    UsageError where there is no such array, or it has another value than 0 and 1; NothingComparable where it counts at
    the last step, and was not given there.
    """
    flag = _array(recording, name)
    values, given = (
        recording.state(ENV, one)[:, :, 0, 0] if one else None for one in (flag, _flag_of(recording, flag))
    )
    assert values is not None
    env, last = table.env[rows], table.last_row[rows]
    told = np.ones(values.shape, dtype=np.bool_) if given is None else given != 0
    odd = told & (values != 0) & (values != 1)
    if odd.any():
        row, of = map(int, np.argwhere(odd)[0])
        raise UsageError(
            f"--success takes a flag; {flag} of {recording.path} is {values[row, of]:g} in environment {of}, row {row}"
        )
    reached = told & (values != 0)
    if at is At.ANY:
        count = np.cumsum(reached, axis=0)
        found: NDArray[np.bool_] = count[last, env] > count[table.first_row[rows], env]
        return found
    if not told[last, env].all():
        missing = int((~told[last, env]).sum())
        raise NothingComparable(
            f"{missing} of {rows.size} episodes of {recording.path} have no {name} in the info of their last step; "
            "--success-at any counts those in which a step has it"
        )
    at_last: NDArray[np.bool_] = reached[last, env]
    return at_last


def _array(recording: Recording, name: str) -> str:
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    scalars = [one.field for one in recording.fields if one.group == ENV and one.width == 1]
    for candidate in (_INFO + plain, plain):
        if candidate in scalars:
            return candidate
    infos = [one.removeprefix(_INFO) for one in scalars if one.startswith(_INFO) and not one.endswith(_GIVEN)]
    raise UsageError(
        f"{recording.path} has no info {name}; it has {', '.join(infos) or 'none'}, and the flags terminated and "
        'truncated. gpusimbench.wrap(..., infos=("success",)) records infos'
    )


def _flag_of(recording: Recording, array: str) -> str:
    given = f"{array}{_GIVEN}"
    return given if any(one.field == given for one in recording.fields) else ""
