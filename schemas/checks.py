"""Values out of a stranger's JSON: of the right kind and size, or an error that names them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, NoReturn

from schemas.errors import DamagedRecording

MAX_COUNT = 1 << 40


def load(name: str, text: str | bytes) -> dict[str, Any]:
    """A JSON object; DamagedRecording where the text is none. NaN and Infinity are not JSON."""
    try:
        record = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DamagedRecording(f"{name} is not JSON: {str(error) or type(error).__name__}") from None
    if not isinstance(record, dict):
        raise DamagedRecording(f"{name} is not a JSON object")
    return record


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a number")


def text(record: Mapping[str, Any], key: str, default: str | None = None) -> str:
    """A string."""
    value = record.get(key, default)
    if not isinstance(value, str):
        raise DamagedRecording(f"{key} is not a text: {_short(value)}")
    return value


def whole(record: Mapping[str, Any], key: str, low: int, high: int, default: int | None = None) -> int:
    """A whole number from low to high."""
    value = record.get(key, default)
    if type(value) is not int or not low <= value <= high:
        raise DamagedRecording(f"{key} is not a whole number from {low} to {high}: {_short(value)}")
    return value


def number(record: Mapping[str, Any], key: str, low: float, high: float) -> float:
    """A finite number from low to high."""
    value = record.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise DamagedRecording(f"{key} is not a number from {low:g} to {high:g}: {_short(value)}")
    return float(value)


def mapping(record: Mapping[str, Any], key: str) -> dict[str, Any]:
    """An object; empty where the key is missing."""
    value = record.get(key, {})
    if not isinstance(value, dict):
        raise DamagedRecording(f"{key} is not an object: {_short(value)}")
    return value


def texts(record: Mapping[str, Any], key: str) -> tuple[str, ...]:
    """A list of strings."""
    return tuple(text({key: item}, key) for item in items(record, key))


def items(record: Mapping[str, Any], key: str) -> list[Any]:
    """A list; empty where the key is missing."""
    value = record.get(key, [])
    if not isinstance(value, list):
        raise DamagedRecording(f"{key} is not a list: {_short(value)}")
    return value


def text_map(record: Mapping[str, Any], key: str) -> dict[str, str]:
    """An object of strings."""
    return {name: text({name: value}, name) for name, value in mapping(record, key).items()}


def objects(record: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    """A list of objects."""
    return [mapping({key: item}, key) for item in items(record, key)]


def vector(value: Any, size: int, what: str) -> tuple[float, ...]:
    """A list of finite numbers of a given length."""
    good = isinstance(value, list) and len(value) == size
    if not good or not all(type(x) in (int, float) and math.isfinite(x) for x in value):
        raise DamagedRecording(f"{what} is not a list of {size} finite numbers: {_short(value)}")
    return tuple(float(x) for x in value)


def _short(value: Any) -> str:
    shown = repr(value) if not isinstance(value, int) or abs(value) < 10**30 else "a huge number"
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
