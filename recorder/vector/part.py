"""What environments are fed in a replay; known without Gymnasium, which only the replay itself needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

ACTION = "action"
"""Of the arrays of actions, the beginning of the name."""

State = Mapping[str, NDArray[np.floating]]
"""MuJoCo's "qpos" and "qvel", in the units of the model; of ManiSkill and robosuite, the arrays of
a whole state by their names in a recording."""


@dataclass(frozen=True)
class Part:
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
