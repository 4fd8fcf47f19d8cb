"""Values as JSON has them: results of this project, and what stands in a stranger's JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.missing import Missing, known, why_missing
from gpusimbench.schemas.location import Location

_DEEPEST = 8


def values_of(result: Any) -> Any:
    """A result as JSON has it: dataclasses by the names of their fields, numbers that are not finite as null.

    A field `x` that may be Missing is null then; `no_x` beside it has the reason, and is empty where there is a value.
    For this project's own results. A stranger's JSON goes through `plain`, which bounds its depth.
    """
    if is_dataclass(result) and not isinstance(result, type):
        return dict(_entries(result))
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


def picked(result: Any, names: str) -> dict[str, Any]:
    """Attributes of a result as JSON has them, under their own names: "n_env dt seed". What is Missing is null."""
    return {name: values_of(known(getattr(result, name))) for name in names.split()}


def _entries(result: Any) -> Iterator[tuple[str, Any]]:
    for field in fields(result):
        value = getattr(result, field.name)
        yield field.name, None if isinstance(value, Missing) else values_of(value)
        if Missing.__name__ in str(field.type):
            yield f"no_{field.name}", why_missing(value)


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
