"""Values as JSON has them: results of this project, and what stands in a stranger's JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.location import Location

_DEEPEST = 8

_NO_VALUE = "missing"

MISSING = f"_{_NO_VALUE}"
"""Behind the name of a key: that of the key with the reason why there is no value."""


def values_of(result: Any) -> Any:
    """A result as JSON has it: dataclasses by the names of their fields, numbers that are not finite as null.

    A field that may be Missing has its reason beside it: see `entry`. Missing by itself, in a list or under a name that
    is no key of ours, is an object with the reason alone, `missing`. For this project's own results. A stranger's JSON
    goes through `plain`, which bounds its depth.
    """
    if isinstance(result, Missing):
        return {_NO_VALUE: result.reason}
    if is_dataclass(result) and not isinstance(result, type):
        return picked(result, *(field.name for field in fields(result)))
    if isinstance(result, Mapping):
        return {str(key): values_of(item) for key, item in result.items()}
    if isinstance(result, (list, tuple)):
        return [values_of(item) for item in result]
    if isinstance(result, Enum):
        return result.value
    if isinstance(result, range):
        return {"first": result.start, "count": len(result)}
    if isinstance(result, (Path, Location)):
        return str(result).encode("utf-8", "backslashreplace").decode()
    if isinstance(result, float):
        return result if math.isfinite(result) else None
    if result is None or isinstance(result, (bool, int, str)):
        return result
    return values_of(result.item())  # a number of numpy's


def entry(name: str, value: Any, reason: str = "") -> dict[str, Any]:
    """A value that may be missing, and the reason: `x` is null then, and `x_missing` is empty where there is a value.

    reason  where the value does not say it itself, as Missing does
    """
    return {name: values_of(known(value)), name + MISSING: why_missing(value) or reason}


def picked(result: Any, *names: str) -> dict[str, Any]:
    """Attributes of a result as JSON has them, under their own names: "n_env dt seed".

    What may be Missing is an `entry`. The declared type says whether it may be, so that every document has the key with
    the reason.
    """
    types = {field.name: str(field.type) for field in fields(result)} if is_dataclass(result) else {}
    found: dict[str, Any] = {}
    for name in " ".join(names).split():
        value = getattr(result, name)
        if isinstance(value, Missing) or Missing.__name__ in types.get(name, ""):
            found |= entry(name, value)
        else:
            found[name] = values_of(value)
    return found


def document_of(record: Mapping[str, Any]) -> dict[str, Any]:
    """What a command writes, behind the version of its keys."""
    return {"schema_version": SCHEMA_VERSION, **values_of(record)}


def dump(document: Any) -> str:
    """A document as text, ending in a newline."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def plain(value: Any, depth: int = 0) -> Any:
    """The value as JSON has it: what is nested deeper than anything that a recorder writes becomes "...".

    Infinite numbers become text; tuples become lists.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if not isinstance(value, (dict, list, tuple)):
        return value
    if depth >= _DEEPEST:
        return "..."
    if isinstance(value, dict):
        return {str(key): plain(item, depth + 1) for key, item in value.items()}
    return [plain(item, depth + 1) for item in value]


def brief(value: Any) -> Any:
    """A scalar as it is, anything else as one line of JSON."""
    value = plain(value)
    return json.dumps(value, sort_keys=True) if isinstance(value, (dict, list)) else value
