"""One episode of a data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gpusimbench.schemas.errors import DamagedRecording

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
    infos         what the info of each step said, by name, [T]; NaN where it said nothing
    model         MJCF of the model in which it was made; None where the task alone decides
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
    model: str | None = None

    def __len__(self) -> int:
        return len(self.rewards)


def checked(path: Path, found: Demonstration) -> Demonstration:
    """The same episode; DamagedRecording where its arrays contradict each other."""
    n = len(found)
    if not n:
        raise DamagedRecording(f"{path} has an episode without a step")
    if found.rewards.ndim != 1:
        raise DamagedRecording(f"{path}: rewards have the shape {found.rewards.shape}, and not one number a step")
    for what, arrays in (("observations", found.observations), ("actions", found.actions)):
        if not arrays or not all(array.size for array in arrays.values()):
            raise DamagedRecording(f"{path} has an episode whose {what} have no numbers")
    if any(len(array) not in (n, n + 1) for array in found.observations.values()) or any(
        len(array) != n for array in (*found.actions.values(), *found.physics.values())
    ):
        raise DamagedRecording(f"{path}: the arrays of an episode of {n} steps have other lengths")
    if odd := [name for name, array in found.infos.items() if array.shape != (n,)]:
        raise DamagedRecording(f"{path}: {odd[0]} of an episode of {n} steps has the shape {found.infos[odd[0]].shape}")
    if len({len(array) for array in found.observations.values()}) > 1:
        raise DamagedRecording(f"{path}: the observations of an episode of {n} steps have different lengths")
    return found
