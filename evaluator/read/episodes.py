"""Episodes of recorded environments: what happened between two resets, whichever way these were made."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.episode_table import episode_table, has_episodes, has_rewards
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.vector import FINAL_GIVEN

_FLAGS = ("terminated", "truncated")


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
