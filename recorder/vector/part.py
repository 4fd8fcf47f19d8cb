"""What environments are fed in a replay; known without Gymnasium, which only the replay itself needs."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.vector import MODELS, SEEDS

ACTION = "action"
"""Of the arrays of actions, the beginning of the name."""

State = Mapping[str, NDArray[np.floating]]
"""MuJoCo's "qpos" and "qvel", in the units of the model; of ManiSkill and robosuite, the arrays of
a whole state by their names in a recording."""


@dataclass(frozen=True)
class GivenEpisode:
    """What an environment is fed in one episode.

    actions  by the name of the array in a recording, [step, ...], in the dtype that the environment was given
    seed     of the reset that begins it; None: the environment goes on with its random numbers
    state    with which it begins; None: the reset decides
    model    MJCF of the model in which it begins; None: that of the task
    """

    actions: Mapping[str, NDArray[Any]]
    seed: int | None = None
    state: State | None = None
    model: str | None = None

    def __len__(self) -> int:
        return len(next(iter(self.actions.values()), ()))


class EpisodeStart(Protocol):
    """An episode of which the seed of its reset and the model in which it begins are known; None where they are not."""

    @property
    def seed(self) -> int | None: ...
    @property
    def model(self) -> str | None: ...


def attachments(parts: Sequence[Sequence[EpisodeStart]]) -> dict[str, tuple[str, bytes]]:
    """What a recording of episodes [env][episode] keeps of how each began: media type and bytes, by name.

    Empty where neither seeds nor models are known.
    """
    found = {}
    every = [part for of_env in parts for part in of_env]
    if any(part.seed is not None for part in every):
        seeds = [[part.seed for part in of_env] for of_env in parts]
        found[SEEDS] = ("application/json", json.dumps(seeds).encode())
    if any(part.model is not None for part in every):
        texts = list(dict.fromkeys(part.model for part in every if part.model is not None))
        numbers = {text: number for number, text in enumerate(texts)}
        of_parts = [[None if part.model is None else numbers[part.model] for part in of_env] for of_env in parts]
        told = json.dumps({"models": texts, "episodes": of_parts})
        found[MODELS] = ("application/gzip", gzip.compress(told.encode(), mtime=0))
    return found
