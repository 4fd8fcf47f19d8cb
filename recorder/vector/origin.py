"""How a vector environment was made and its episodes begun, as far as a recording can say it, so that a replay can make
it again. It is known without Gymnasium, which only the replay itself needs."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.vector import MODELS, NO_SEED, RESET_SEEDS, SEEDS

SPEC_ID, KEYWORDS, WRAPPERS, VECTORIZED = "env_id", "env_kwargs", "env_wrappers", "vectorization"
"""Options of a recording: id of Gymnasium's registry, keywords as JSON, names of wrappers, "sync" or another word."""

STATED = "maniskill"
"""VECTORIZED of environments of ManiSkill whose observations are their states, in which episodes can begin."""

SUITED = "robosuite"
"""VECTORIZED of environments of robosuite, observed and begun likewise."""

NOT_JSON = "no JSON"
"""What stands for keywords that are no plain values, such as functions."""

_ONLY_WATCH = ("stable_baselines3.common.monitor:Monitor",)
"""Wrappers that change no number that an environment is given or returns."""

_OF_THE_VECTOR = ("num_envs", "vectorization_mode", "vector_kwargs", "wrappers")


def seed_of(seed: Any) -> tuple[int, dict[str, str]]:
    """The seed of a reset, 0 where it is no whole number, and then the option that says what was given instead."""
    if isinstance(seed, Integral):
        return int(seed), {}
    return 0, {RESET_SEEDS: NO_SEED if seed is None else ", ".join(map(str, seed))}


def origin_of(envs: Any) -> dict[str, str]:
    """Options that say how an environment of Gymnasium's registry was made; none where it is not of the registry.

    envs  a vector environment; where it has no specification, that of its first environment counts, if it lives in this
          process
    """
    whole = envs.unwrapped
    own = getattr(envs, "spec", None)
    spec = own or next((getattr(env, "spec", None) for env in getattr(whole, "envs", ())), None)
    if spec is None or not getattr(spec, "id", ""):
        return {}
    given = dict(spec.kwargs)
    of_vector = {name: given.pop(name) for name in _OF_THE_VECTOR if name in given}
    if spec.max_episode_steps is not None:
        given.setdefault("max_episode_steps", spec.max_episode_steps)
    wrappers = [
        *(wrapper.name for wrapper in spec.additional_wrappers if wrapper.entry_point not in _ONLY_WATCH),
        *(
            getattr(wrapper, "__name__", type(wrapper).__name__)
            for wrapper in of_vector.get("wrappers", ())
            if not getattr(wrapper, "__module__", "").startswith("gpusimbench.")  # which changes no number by itself
        ),
    ]
    return {
        SPEC_ID: spec.id,
        KEYWORDS: _json(given),
        VECTORIZED: str(of_vector.get("vectorization_mode", "sync")),
        **({WRAPPERS: ", ".join(wrappers)} if wrappers else {}),
    }


def _json(keywords: dict[str, Any]) -> str:
    try:
        return json.dumps(keywords, sort_keys=True)
    except (TypeError, ValueError):
        return NOT_JSON


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
