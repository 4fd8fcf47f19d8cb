"""A data set of demonstrations on this machine, whatever its format."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gpusimbench.recorder.demonstrations.demonstration import Demonstration
from gpusimbench.schemas.errors import DamagedRecording

_LONGEST = 256  # of a name


def name_of(told: object) -> str:
    """What a file says, if it can be the name of a task or a version: a line of text; empty otherwise."""
    return told if isinstance(told, str) and told.isprintable() and len(told) <= _LONGEST else ""


def read_json(file: Path, most: int) -> Any:
    """What a file of metadata says; DamagedRecording where it has more than `most` bytes, or is no JSON."""
    try:
        if file.stat().st_size > most:
            raise DamagedRecording(f"{file} is too large")
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DamagedRecording(f"{file} cannot be read: {type(error).__name__}") from None


@dataclass(frozen=True)
class Made:
    """How an environment was made, as far as known: id and keywords of Gymnasium's registry, names of wrappers.

    vectorization  see registered of recorder.vector.making
    """

    spec_id: str = ""
    keywords: dict[str, Any] = field(default_factory=dict)
    wrappers: tuple[str, ...] = ()
    vectorization: str = "sync"


@dataclass(frozen=True)
class DataSet:
    """What a format says of a path; nothing but metadata is read until `read` is called.

    path     file or folder, for errors
    name     of the recording that is made of it
    version  of the format, for that recording
    files    all that is read, in order
    read     the episodes, in order: a number of them at most, or all (None), with arrays named as those of an
             environment that has the given space of observations
    made     how its environment was made
    dt       time between two frames [s]; None where it is not known
    at_once  environments at most, over which the episodes are dealt; 1: a single one goes through them in their order
    """

    path: Path
    name: str
    version: str
    files: tuple[Path, ...]
    read: Callable[[int | None, Any], list[Demonstration]]
    made: Made = field(default_factory=Made)
    dt: float | None = None
    at_once: int = 16
