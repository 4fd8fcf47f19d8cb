"""Results as JSON documents, for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from evaluator.missing import Missing, why_missing
from schemas.location import Location


def values_of(result: Any) -> Any:
    """A result as JSON has it: dataclasses by the names of their fields, numbers that are not finite as null.

    A field `x` that may be Missing is null then; `no_x` beside it has the reason, and is empty where there is a value.
    For this project's own results. A stranger's JSON goes through ``evaluator.plain``, which bounds its depth.
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


def _entries(result: Any) -> Iterator[tuple[str, Any]]:
    for field in fields(result):
        value = getattr(result, field.name)
        yield field.name, None if isinstance(value, Missing) else values_of(value)
        if Missing.__name__ in str(field.type):
            yield f"no_{field.name}", why_missing(value)


def dump(document: Any) -> str:
    """A document as text, ending in a newline."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
