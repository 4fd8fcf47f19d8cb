"""Which episode each environment is in, and at which of its steps, whenever its episodes end and begin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.vector.modes import Mode


class Ledger:
    """Counts episodes and their steps; the present observations of all environments are what is counted.

    episode  of each environment's present observation, from 0, [env]
    step     of that episode, 0 where the observation is its first, [env]
    """

    def __init__(self, n_env: int, mode: Mode) -> None:
        self._mode = mode
        self.episode = np.zeros(n_env, dtype=np.int64)
        self.step = np.zeros(n_env, dtype=np.int64)
        self._ended = np.zeros(n_env, dtype=np.bool_)

    def stepped(self, done: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Every environment was stepped once, and the episodes of some ended.

        Returns which environments began their next episode instead of making a step: the last observation of an
        episode is not stepped from.
        """
        began = self._ended.copy() if self._mode is Mode.NEXT_STEP else np.zeros_like(self._ended)
        self.step += 1
        self._begin(began)
        self._ended = done & ~began
        if self._mode is Mode.SAME_STEP:
            self._begin(done)
        return began

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Some environments were reset by their user."""
        self._begin(mask)

    def _begin(self, mask: NDArray[np.bool_]) -> None:
        self.episode[mask] += 1
        self.step[mask] = 0
        self._ended &= ~mask
