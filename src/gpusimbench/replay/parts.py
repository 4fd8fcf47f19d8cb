"""What a recording says of how its environment was made, and what each of its environments is fed."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.episode_table import has_episodes
from gpusimbench.evaluator.read.episodes import episodes
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.vector.infos import GIVEN
from gpusimbench.recorder.vector.open_loop import ACTION, Part
from gpusimbench.recorder.vector.origin import KEYWORDS, NOT_JSON, SPEC_ID, VECTORIZED, WRAPPERS
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable, UsageError
from gpusimbench.schemas.fields import ENV

_FROM = re.compile(r"recorded from (\w+)")
_INFO = "info_"
_PATHS = ("/", "\\", ":")
"""In a text of a stranger they may name a file, a module or an address."""


@dataclass(frozen=True)
class Origin:
    """How an environment is made: id and keywords of Gymnasium's registry.

    vectorization  see registered of recorder.vector.making
    """

    spec_id: str
    keywords: dict[str, Any]
    vectorization: str


def origin_of(recording: Recording, named: str | None, changed: dict[str, Any]) -> Origin:
    """How the environment of a recording is made again.

    named    id that the user names; None: the recorded one
    changed  keywords that the user names

    Nothing that a file says is imported or opened: UsageError for an id with a module, keywords that may be paths, or
    wrappers, which the user has to name.
    """
    options = recording.configuration.options
    spec_id, told = options.get(SPEC_ID, ""), options.get(KEYWORDS, "{}")
    if named is None:
        if not spec_id or ":" in spec_id:
            raise UsageError(f"{recording.path} names no environment of Gymnasium's registry: give --env, or --make")
        if wrappers := options.get(WRAPPERS):
            raise UsageError(f"{recording.path} was recorded with the wrappers {wrappers}: make them in --make")
        if told == NOT_JSON:
            raise UsageError(f"{recording.path} was made with keywords that no file holds: use --make")
    keywords = _keywords(recording, told) if named is None or named == spec_id else {}
    odd = [name for name, value in keywords.items() if name not in changed and _may_be_a_path(value)]
    if odd:
        raise UsageError(
            f"keyword {odd[0]} of {recording.path} may name a file: if you trust it, give --set {odd[0]}=..."
        )
    return Origin(named or spec_id, {**keywords, **changed}, options.get(VECTORIZED, "sync"))


def _keywords(recording: Recording, told: str) -> dict[str, Any]:
    try:
        found = json.loads(told)
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise DamagedRecording(f"{recording.path}: {KEYWORDS} are no keywords")
    return found


def _may_be_a_path(value: Any) -> bool:
    if isinstance(value, str):
        return any(mark in value for mark in _PATHS)
    if isinstance(value, dict):
        return any(_may_be_a_path(one) for one in value.values())
    return isinstance(value, list) and any(map(_may_be_a_path, value))


def seed_of(recording: Recording) -> Any:
    """Of the first reset: a number, one of each environment, or None where none was given."""
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


def parts_of(recording: Recording) -> list[list[Part]]:
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
    parts: list[list[Part]] = [[] for _ in range(recording.configuration.n_env)]
    for episode in episodes(recording):
        if episode.number != len(parts[episode.env]):
            raise NothingComparable(f"{recording.path}: episodes of environment {episode.env} are missing")
        parts[episode.env].append(Part({name: _as(array, dtypes[name]) for name, array in episode.actions.items()}))
    return parts


def _as(array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    return array.astype(dtype)


def given(texts: Sequence[str]) -> dict[str, Any]:
    """Keywords of "NAME=VALUE": JSON where a value is that, a text otherwise."""
    found: dict[str, Any] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name.isidentifier():
            raise UsageError(f"--set takes NAME=VALUE, not '{text}'")
        try:
            found[name] = json.loads(value)
        except ValueError:
            found[name] = value
    return found
