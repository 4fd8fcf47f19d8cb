"""When a vector environment begins the next episode, what it says of the last one, and which episode each is in."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import leaves, on_host

FINAL = "final_observation"


def final_name(observation: str) -> str:
    """The array of what steps led to, by that of what the next action is based on."""
    return observation.replace("observation", FINAL, 1)


class Mode(Enum):
    """When an environment whose episode has ended is reset; the words are those of Gymnasium.

    NEXT_STEP  by the next call of step, which ignores its action
    SAME_STEP  by the call of step that ends the episode, which returns the next episode's first observation
    DISABLED   by its user, with the option reset_mask
    NONE       not known; a single environment, which its user resets
    """

    NEXT_STEP = "NextStep"
    SAME_STEP = "SameStep"
    DISABLED = "Disabled"
    NONE = "none"


def mode_of(envs: Any) -> Mode:
    """The mode that the metadata of an environment name; NONE where they name none."""
    told = (getattr(envs, "metadata", None) or {}).get("autoreset_mode")
    word = str(getattr(told, "value", told)).lower().replace("_", "")
    return next((mode for mode in Mode if mode.value.lower() == word), Mode.NONE)


def five(returned: Any) -> tuple[Any, ...]:
    """What step returned: observation, reward, terminated, truncated, info; UsageError where it is something else."""
    if not isinstance(returned, (tuple, list)) or len(returned) != 5:
        many = f"{len(returned)} values" if isinstance(returned, (tuple, list)) else type(returned).__name__
        raise UsageError(f"step returned {many}, not observation, reward, terminated, truncated and info")
    return tuple(returned)


def with_final(observation: Any, info: Mapping[str, Any], done: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Observations, and in the environments that are done those with which their episodes ended, by name.

    info  its "final_obs" are such observations, each of one environment, or arrays of all environments

    UsageError where there are none.
    """
    before = {name: on_host(value, name) for name, value in leaves(observation, FINAL)}
    if not done.any():
        return before
    final = info.get("final_obs", info.get(FINAL))
    if final is None:
        raise UsageError("an episode ended in a step that begins the next one, and info has no final_obs")
    by_env = isinstance(final, np.ndarray) and final.dtype == object
    for env in np.flatnonzero(done):
        for name, value in leaves(final[env] if by_env else final, FINAL):
            array = on_host(value, name)
            before[name][env] = array if by_env else array[env]
    return before


class Ledger:
    """Counts episodes and their steps; the present observations of all environments are what is counted.

    episode  of each environment's present observation, from 0, [env]
    step     of that episode, 0 where the observation is its first, [env]
    """

    def __init__(self, n_env: int, mode: Mode) -> None:
        self._mode = mode
        self.episode = np.zeros(n_env, dtype=np.int64)
        self.step = np.zeros(n_env, dtype=np.int64)
        self._none = np.zeros(n_env, dtype=np.bool_)
        self._ended = self._none  # which the next call of step resets

    def stepped(self, done: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Every environment was stepped once, and the episodes of some ended.

        Returns which environments began their next episode instead of making a step: the last observation of an
        episode is not stepped from.
        """
        began, self._ended = self._ended, self._none
        self.step += 1
        if began is not self._none:  # most steps are within episodes, and cost no more than the count
            self._begin(began)
            done = done & ~began
        if done.any():
            if self._mode is Mode.SAME_STEP:
                self._begin(done)
            elif self._mode is Mode.NEXT_STEP:
                self._ended = done
        return began

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Some environments were reset by their user."""
        self._begin(mask)

    def _begin(self, mask: NDArray[np.bool_]) -> None:
        self.episode[mask] += 1
        self.step[mask] = 0
        if self._ended is not self._none:
            self._ended = self._ended & ~mask
