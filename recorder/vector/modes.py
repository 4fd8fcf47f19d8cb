"""When a vector environment begins the next episode, and what it says of the last one."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import leaves, on_host

FINAL = "final_observation"


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
