"""A comparison as JSON, for programs."""

from __future__ import annotations

import json
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from evaluator.diff.result import SCHEMA_VERSION, Difference


def to_json(found: Difference) -> dict[str, Any]:
    """The document that ``gsb-diff --json`` prints: the result's own names, the verdict, and whether it is over all."""
    return {
        "schema_version": SCHEMA_VERSION,
        "verdict": found.verdict.value,
        "all_compared": not (found.compared.left_out or found.lost),
        "lost": list(found.lost),
        **_plain(found),
    }


def dump_json(found: Difference) -> str:
    """The same as text, ending in a newline."""
    return json.dumps(to_json(found), indent=1, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, range):
        return {"first": value.start, "count": len(value)}
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value
