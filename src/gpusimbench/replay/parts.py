"""What each environment of a recording is fed: actions, seeds, states."""

from __future__ import annotations

import json
import re
import zlib
from typing import Any

import numpy as np

from gpusimbench.evaluator.read.episodes import episode_table, episodes, has_episodes, rows_of
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.vector.fields import GIVEN, array_name, field_of
from gpusimbench.recorder.vector.origin import ACTION, STATED, SUITED, VECTORIZED, GivenEpisode, State
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable
from gpusimbench.schemas.fields import ENV
from gpusimbench.schemas.vector import MODELS, PHYSICS, SEEDS

_FROM = re.compile(r"recorded from (bool|u?int(?:8|16|32|64)|float16)\b")
_MOST_OF_MODELS = 1 << 30  # bytes of their texts
_INFO, _OBSERVATION = "info_", "observation"
_PHYSICS = (f"{PHYSICS}qpos", f"{PHYSICS}qvel")


def seed_of(recording: Recording) -> Any:
    """The seed of the first reset: a number, a number for each environment, or None where none was given."""
    if own := _seeds(recording):
        return [own.get((env, 0)) for env in range(recording.configuration.n_env)]
    told = recording.configuration.options.get("seeds")
    if told is None:
        return recording.configuration.seed
    words = told.split(", ")
    if len(words) != recording.configuration.n_env or not all(re.fullmatch(r"\d{1,19}|None", word) for word in words):
        return None
    return [None if word == "None" else int(word) for word in words]


def infos_of(recording: Recording) -> tuple[str, ...]:
    """Names of the infos that were recorded."""
    if told := recording.configuration.options.get("infos"):
        return tuple(told.split(", "))
    names = [one.field for one in recording.fields if one.group == ENV and one.field.startswith(_INFO)]
    return tuple(name.removeprefix(_INFO) for name in names if not name.endswith(GIVEN))


def given_at_first(recording: Recording, info: str) -> bool:
    """Whether some environment gave a recorded info in its first step."""
    if info not in infos_of(recording) or recording.configuration.steps < 1:
        return False
    name = field_of(array_name(info) + GIVEN, np.dtype(np.bool_), ()).field
    return bool((recording.state(ENV, name)[1] != 0).any())


def parts_of(recording: Recording) -> list[list[GivenEpisode]]:
    """What each environment is fed, [env][episode]; NothingComparable where there are no episodes."""
    if not has_episodes(recording):
        raise NothingComparable(
            f"{recording.path} has no episodes: gpusimbench.wrap records them; gsb-audit replays runs of gsb-record"
        )
    dtypes = {
        one.field: np.dtype(found.group(1) if (found := _FROM.search(one.note)) else one.dtype)
        for one in recording.fields
        if one.group == ENV and one.field.startswith(ACTION)
    }
    seeds, states, models = _seeds(recording), _states(recording), _models(recording)
    parts: list[list[GivenEpisode]] = [[] for _ in range(recording.configuration.n_env)]
    for episode in episodes(recording):
        env, number = episode.env, episode.number
        if number != len(parts[env]):
            raise NothingComparable(f"{recording.path}: episodes of environment {env} are missing")
        actions = {name: array.astype(dtypes[name]) for name, array in episode.actions.items()}
        at = (env, number)
        parts[env].append(GivenEpisode(actions, seeds.get(at), states.get(at), models.get(at)))
    if not any(parts):
        raise NothingComparable(f"{recording.path} has no step of an episode")
    return parts


def _seeds(recording: Recording) -> dict[tuple[int, int], int]:
    """The seeds of episodes whose reset had a seed of its own, by environment and number."""
    text = recording.attachment(SEEDS)
    try:
        told = [] if text is None else json.loads(text)
        found = {(env, number): seed for env, of_env in enumerate(told) for number, seed in enumerate(of_env)}
    except (ValueError, TypeError, RecursionError):
        found = {(0, 0): "no JSON"}
    if not all(seed is None or (type(seed) is int and seed >= 0) for seed in found.values()):
        raise DamagedRecording(f"{recording.path}: {SEEDS} has something else than seeds")
    return {key: seed for key, seed in found.items() if seed is not None}


def _models(recording: Recording) -> dict[tuple[int, int], str]:
    """MJCF of the model in which an episode begins, by environment and number, where it has one of its own."""
    packed = recording.attachment(MODELS)
    if packed is None:
        return {}
    try:
        unpacking = zlib.decompressobj(wbits=31)  # of gzip
        text = unpacking.decompress(packed, _MOST_OF_MODELS)
        if not unpacking.eof:
            raise ValueError
        told = json.loads(text)
        found = {
            (env, number): told["models"][model]
            for env, of_env in enumerate(told["episodes"])
            for number, model in enumerate(of_env)
            if model is not None
        }
        if not all(isinstance(model, str) for model in found.values()):
            raise ValueError
    except (ValueError, TypeError, LookupError, RecursionError, zlib.error):
        raise DamagedRecording(f"{recording.path}: {MODELS} has something else than models") from None
    return found


def _states(recording: Recording) -> dict[tuple[int, int], State]:
    """The state at the first observation of each episode, where the recording has it."""
    of_envs = [field.field for field in recording.fields if field.group == ENV]
    if recording.configuration.options.get(VECTORIZED) in (STATED, SUITED):
        names = [name for name in of_envs if name.startswith(_OBSERVATION)]
    else:
        names = [name for name in _PHYSICS if name in of_envs]
        if len(names) < len(_PHYSICS):
            return {}
    table = episode_table(recording)
    rows = rows_of(recording, names, table.env, table.first_row)
    return {
        (int(env), int(number)): {name.removeprefix(PHYSICS): array[i] for name, array in rows.items()}
        for i, (env, number) in enumerate(zip(table.env, table.number, strict=True))
    }
