"""One episode of a data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Demonstration:
    """An episode of T steps; units are those of the task.

    observations  by the name of the array, [T + 1, ...], or [T, ...] where the data set lacks the last one
    actions       by name, [T, ...]; action t follows observation t
    rewards       [T]
    terminated, truncated  whether the task ended it so at its last step
    seed          of the reset that began it; None where the data set has none
    physics       MuJoCo's "qpos" and "qvel" at each action, [T, ...]; empty where the data set has none
    rewarded      whether the data set has rewards; zeros stand for them where it has not
    infos         what the info of each step said, by name, [T]
    """

    observations: Arrays
    actions: Arrays
    rewards: NDArray[Any]
    terminated: bool
    truncated: bool
    seed: int | None
    physics: Arrays
    rewarded: bool = True
    infos: Arrays = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.rewards)
