"""Environments, stepped from a seed: what they return, as arrays [step, env, ...]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.diff.arrays import Rows
from gpusimbench.recorder.vector.modes import FINAL, Mode, mode_of, with_final
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.trees import leaves, mapped, on_host

_STEPPED = ("observation", "reward", "terminated", "truncated")


def drawn_actions(env: Any, steps: int, seed: int) -> list[Any]:
    """An action for each step, drawn from the environment's action space; None for each where it has no such space."""
    space = getattr(env, "action_space", None)
    if space is None:
        return [None] * steps
    space.seed(seed)
    return [deepcopy(space.sample()) for _ in range(steps)]


def stepped(env: Any, actions: Sequence[Any], seed: int, *, n_env: int | None = None) -> dict[str, Rows]:
    """Reset an environment with a seed and step it once for each action.

    env    a Gymnasium VectorEnv or Env, or anything with reset(seed) and step(action) that returns arrays [env, ...]:
           one, or nested in dicts, tuples and lists
    n_env  environments that there must be; None: any number

    Of a Gymnasium environment there are observation (step 0 is the reset), reward, terminated and truncated; info is
    left out. Where an observation that ends an episode is replaced in the same step by that of the next episode,
    because the environment does so or because it wants to be reset by its user, final_observation has the observations
    before the replacement. Anything else gives its arrays by their names, from step 0 on.

    UsageError where arrays do not have the same environments at every step.
    """
    columns = _Columns(n_env)
    returned = env.reset(seed=seed)
    if not (isinstance(returned, tuple) and len(returned) == 2 and isinstance(returned[1], Mapping)):
        columns.add(0, returned, "")
        for step, action in enumerate(actions, 1):
            columns.add(step, env.step(action), "")
        return columns.rows()
    gym = _Gymnasium(env)
    columns.add(0, gym.batch(returned[0]), _STEPPED[0])
    for step, action in enumerate(actions, 1):
        for name, tree in gym.step(action).items():
            columns.add(step, tree, name)
    return columns.rows()


class _Columns:
    """Arrays of each step by name."""

    def __init__(self, n_env: int | None) -> None:
        self._n_env = n_env
        self._first: dict[str, int] = {}
        self._arrays: dict[str, list[NDArray[Any]]] = {}

    def add(self, step: int, tree: Any, name: str) -> None:
        for found, value in leaves(tree, name):
            array = on_host(value, found)
            n_env = array.shape[0] if array.ndim else None
            self._n_env = n_env if self._n_env is None else self._n_env
            if n_env is None or n_env != self._n_env:
                raise UsageError(
                    f"{found} has shape {array.shape} at step {step}; its first axis must be that of "
                    f"{'the environments' if self._n_env is None else f'{self._n_env} environments'}"
                )
            rows = self._arrays.setdefault(found, [])
            first = self._first.setdefault(found, step)
            if first + len(rows) != step or (rows and (array.shape, array.dtype) != (rows[0].shape, rows[0].dtype)):
                raise UsageError(
                    f"{found} is {array.dtype} {array.shape} at step {step}, and not the same or not there before"
                )
            rows.append(array)

    def rows(self) -> dict[str, Rows]:
        lengths = {first + len(self._arrays[name]) for name, first in self._first.items()}
        if len(lengths) > 1:
            raise UsageError("an array that earlier steps returned was not returned by later ones")
        return {name: Rows(np.stack(arrays), self._first[name]) for name, arrays in self._arrays.items()}


class _Gymnasium:
    """Steps of a Gymnasium environment, in whichever way its episodes begin anew.

    A single environment, and a vector environment whose autoreset is disabled, are reset here as soon as an episode
    ends.
    """

    def __init__(self, env: Any) -> None:
        self._env = env
        self._alone = not any(hasattr(part, "num_envs") for part in (env, getattr(env, "unwrapped", None)))
        self._mode = Mode.NONE if self._alone else mode_of(env)

    def batch(self, tree: Any) -> Any:
        """A tree of one environment with the axis that it lacks."""
        if not self._alone:
            return tree
        return mapped(lambda value: on_host(value, _STEPPED[0])[np.newaxis], tree)

    def step(self, action: Any) -> dict[str, Any]:
        """What a step returns, by name."""
        returned = self._env.step(action)
        if not isinstance(returned, tuple) or len(returned) != 5:
            raise UsageError("step returns (observation, reward, terminated, truncated, info), as Gymnasium has it")
        observation, reward, terminated, truncated, info = returned
        found = dict(zip(_STEPPED, map(self.batch, (observation, reward, terminated, truncated)), strict=True))
        done = on_host(found["terminated"], "terminated") | on_host(found["truncated"], "truncated")
        if self._alone or self._mode is Mode.DISABLED:
            found[FINAL] = deepcopy(found["observation"])
            if done.any():
                options = {} if self._alone else {"options": {"reset_mask": done}}
                found["observation"] = self.batch(self._env.reset(**options)[0])
        elif self._mode is Mode.SAME_STEP:
            found |= with_final(found["observation"], info, done)
        return found
