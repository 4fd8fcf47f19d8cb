"""Faults that can be planted, one for each question of gsb-probe: what makes a result depend on what should not matter.

Each moves the x of the last body of an environment by units in the last place, which contacts amplify.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.simulators.snapshot import Envs

FAULTS = {
    "none": "nothing is planted",
    "number": "at step `at`, all are moved, by as many times `ulps` as there are environments",
    "slot": "at step `at`, environment e is moved by e times `ulps`",
    "neighbours": "from step `at` on, an environment is moved after each step that leaves an odd number of set bits in "
    "the velocities of the next one",
    "poison": "where one is given a state that is not finite, the others are moved",
    "bystanders": "where some are reset, the others are moved",
    "fresh": "where some are reset, they begin moved",
    "restored": "what is restored is moved",
    "process": "what is restored in a process that has made no step is moved",
    "set": "what is given a state after the first step is moved",
    "capture": "what is stepped without being captured is moved",
}
"""By name, what each does."""


class Nudged(Protocol):
    """As much of a World as faults need."""

    done: int

    def nudge(self, ulps: NDArray[np.int32]) -> None: ...
    def state(self) -> list[NDArray[np.float32]]: ...


class Fault:
    """One of FAULTS, in a world of n_env environments."""

    def __init__(self, name: str, ulps: int, at: int, n_env: int) -> None:
        self._name, self._ulps, self._at, self._n_env = name, ulps, at, n_env

    def after_step(self, world: Nudged) -> None:
        """Once a step was made."""
        if self._name in ("number", "slot") and world.done == self._at:
            env = np.arange(self._n_env)
            times = np.full(self._n_env, self._n_env) if self._name == "number" else env
            world.nudge((self._ulps * times).astype(np.int32))
        if self._name == "neighbours" and world.done >= self._at:
            words = np.roll(world.state()[1], -1, axis=0).view(np.uint32).reshape(self._n_env, -1)
            world.nudge((self._ulps * (np.bitwise_xor.reduce(_parity(words), axis=1))).astype(np.int32))

    def after_uncaptured(self, world: Nudged) -> None:
        """Once steps were made that nobody captures."""
        if self._name == "capture":
            world.nudge(np.full(self._n_env, self._ulps, dtype=np.int32))

    def after(self, operation: str, world: Nudged, envs: Envs) -> None:
        """Once some environments were restored ("restored", or "process" before any step was made in this process),
        reset ("fresh") or set ("set")."""
        touched = np.ones(self._n_env, dtype=bool)
        if envs is not None:
            touched[:] = False
            touched[envs] = True
        failed = operation == "set" and self._name == "poison" and not all(np.isfinite(a).all() for a in world.state())
        if failed or (operation == "fresh" and self._name == "bystanders"):
            world.nudge((self._ulps * ~touched).astype(np.int32))
            return
        begins = (operation == "set" and not world.done) or (operation == "fresh" and envs is None)
        if operation == self._name and not begins:
            world.nudge((self._ulps * touched).astype(np.int32))


def _parity(words: NDArray[np.uint32]) -> NDArray[np.uint32]:
    for shift in (16, 8, 4, 2, 1):
        words = words ^ (words >> np.uint32(shift))
    return words & np.uint32(1)
