"""Values out of a stranger's JSON, made safe to show, to compare and to write again: never too deep, always finite."""

from __future__ import annotations

import json
import math
from typing import Any

_DEEPEST = 8


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
