"""How a vector environment was made, as far as a recording can say it, so that it can be made again."""

from __future__ import annotations

import json
from numbers import Integral
from typing import Any

from gpusimbench.schemas.vector import NO_SEED, RESET_SEEDS

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
