"""How the environment of a replay is made: what a file says of it, and what the user does."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.vector.origin import KEYWORDS, NOT_JSON, SPEC_ID, VECTORIZED, WRAPPERS
from gpusimbench.schemas.errors import DamagedRecording, UsageError

_PATHS = ("/", "\\", ":")
"""In a text of a stranger they may name a file, a module or an address."""


@dataclass(frozen=True)
class Origin:
    """How an environment is made: id and keywords of Gymnasium's registry.

    vectorization  see registered of recorder.vector.making
    """

    spec_id: str
    keywords: dict[str, Any]
    vectorization: str = "sync"


def origin_of(recording: Recording, named: str | None, changed: Mapping[str, Any]) -> Origin:
    """How the environment of a recording is made again; see told_or_named. UsageError where it had wrappers."""
    options = recording.configuration.options
    told = options.get(KEYWORDS, "{}")
    if named is None:
        if wrappers := options.get(WRAPPERS):
            raise UsageError(f"{recording.path} was recorded with the wrappers {wrappers}: make them in --make")
        if told == NOT_JSON:
            raise UsageError(f"{recording.path} was made with keywords that no file holds: use --make")
    try:
        keywords = {} if told == NOT_JSON else json.loads(told)
    except (ValueError, RecursionError):
        keywords = None
    if not isinstance(keywords, dict):
        raise DamagedRecording(f"{recording.path}: {KEYWORDS} are no keywords")
    vectorization = options.get(VECTORIZED, "sync")
    return told_or_named(str(recording.path), Origin(options.get(SPEC_ID, ""), keywords, vectorization), named, changed)


def told_or_named(
    file: str, told: Origin, named: str | None, changed: Mapping[str, Any], ways: str = "--env, or --make"
) -> Origin:
    """What a file says, unless the user names something else.

    file     its name, for errors
    named    id that the user names; None: that of the file
    changed  keywords that the user names
    ways     options by which the user can name an environment, for errors

    Nothing that a file says is imported or opened: UsageError for an id with a module, and for keywords that may be
    paths, which the user has to name.
    """
    if named is None and (not told.spec_id or ":" in told.spec_id):
        raise UsageError(f"{file} names no environment of Gymnasium's registry: give {ways}")
    keywords = told.keywords if named is None or same_task(named, told.spec_id) else {}
    if odd := [name for name, value in keywords.items() if name not in changed and _may_be_a_path(value)]:
        raise UsageError(f"keyword {odd[0]} of {file} may name a file: if you trust it, give --set {odd[0]}=...")
    return Origin(named or told.spec_id, {**keywords, **changed}, told.vectorization)


def same_task(named: str, told: str) -> bool:
    """Whether two ids are of the same task, whichever module one of them asks Gymnasium to import."""
    return named.rpartition(":")[2] == told.rpartition(":")[2]


def _may_be_a_path(value: Any) -> bool:
    if isinstance(value, str):
        return any(mark in value for mark in _PATHS)
    if isinstance(value, dict):
        return any(_may_be_a_path(one) for one in value.values())
    return isinstance(value, list) and any(map(_may_be_a_path, value))


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
