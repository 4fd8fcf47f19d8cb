"""A task whose successes are short, and two policies: recorded by gpusimbench.wrap, for gsb-episodes.

Something is in one of 20 places, each as likely as another. A step tries a place; an episode ends when the place is
right, or after 12 tries. The observation is a noisy hint of the place, and the number of tries so far.

usage: python search.py POLICY FILE [N_ENV] [PER_ENV] [SEED]
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import gpusimbench

PLACES, TRIES = 20, 12
_HINT_SD = 5.0  # of the hint about the place [places]


class Search(gymnasium.Env):  # type: ignore[misc]
    """One hidden place; see the top of this file. Actions are numbers of places, observations [hint, tries]."""

    metadata = {"render_fps": 10}  # noqa: RUF012
    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float32)
    action_space = gymnasium.spaces.Discrete(PLACES)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Hide it anew."""
        super().reset(seed=seed)
        self.place, self.tries = int(self.np_random.integers(PLACES)), 0
        self.hint = self.place + _HINT_SD * self.np_random.normal()
        return self._seen(), {}

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Try a place. The info has "success" in every step."""
        self.tries += 1
        right = int(action) == self.place
        return self._seen(), -1.0, right, self.tries == TRIES and not right, {"success": right}

    def _seen(self) -> NDArray[np.float32]:
        return np.array([self.hint, self.tries], dtype=np.float32)


def sweep(observation: NDArray[np.float32]) -> NDArray[np.int64]:
    """Places in order: the policy finds what is in the first 12 of 20 places, so that 60 % of the episodes succeed."""
    return observation[:, 1].astype(np.int64) % PLACES


def near(observation: NDArray[np.float32]) -> NDArray[np.int64]:
    """The place of the hint, then those beside it, by turns on either side."""
    hint, tries = observation[:, 0], observation[:, 1]
    away = np.ceil(tries / 2) * np.where(tries % 2, 1, -1)
    places: NDArray[np.int64] = (np.rint(hint) + away).astype(np.int64) % PLACES
    return places


POLICIES: dict[str, Callable[[NDArray[np.float32]], NDArray[np.int64]]] = {"sweep": sweep, "near": near}


def record(policy: str, path: str | Path, n_env: int = 64, per_env: int = 4, seed: int = 0) -> None:
    """Record enough steps for `per_env` episodes of every environment, however long these are."""
    steps = per_env * (TRIES + 1)  # a call of step that begins an episode makes no step
    envs = gymnasium.vector.SyncVectorEnv([Search] * n_env)
    envs = gpusimbench.wrap(envs, path, steps=steps, infos=("success",))
    observation, _ = envs.reset(seed=seed)
    for _ in range(steps):
        observation, *_ = envs.step(POLICIES[policy](observation))
    envs.close()


if __name__ == "__main__":
    record(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))
