"""A data set of demonstrations on this machine, and one episode of it, whatever its format."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
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


_LONGEST = 256  # of a name


def name_of(told: object) -> str:
    """What a file says, if it can be the name of a task or a version: a line of text; empty otherwise."""
    return told if isinstance(told, str) and told.isprintable() and len(told) <= _LONGEST else ""


def read_json(file: Path, most: int) -> Any:
    """What a file of metadata says; DamagedRecording where it has more than `most` bytes, or is no JSON."""
    try:
        if file.stat().st_size > most:
            raise DamagedRecording(f"{file} is too large")
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DamagedRecording(f"{file} cannot be read: {type(error).__name__}") from None


@dataclass(frozen=True)
class Made:
    """How an environment was made, as far as known: id and keywords of Gymnasium's registry, names of wrappers.

    vectorization  see registered of recorder.vector.making
    """

    spec_id: str = ""
    keywords: dict[str, Any] = field(default_factory=dict)
    wrappers: tuple[str, ...] = ()
    vectorization: str = "sync"


@dataclass(frozen=True)
class DataSet:
    """What a format says of a path; nothing but metadata is read until `read` is called.

    path     file or folder, for errors
    name     of the recording that is made of it
    version  of the format, for that recording
    files    all that is read, in order
    read     the episodes, in order: a number of them at most, or all (None), with arrays named as those of an
             environment that has the given space of observations
    made     how its environment was made
    dt       time between two frames [s]; None where it is not known
    at_once  environments at most, over which the episodes are dealt; 1: a single one goes through them in their order
    """

    path: Path
    name: str
    version: str
    files: tuple[Path, ...]
    read: Callable[[int | None, Any], list[Demonstration]]
    made: Made = field(default_factory=Made)
    dt: float | None = None
    at_once: int = 16
