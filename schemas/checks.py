"""Values out of a stranger's JSON: of the right kind and size, or an error that names them."""

from __future__ import annotations

import json
import reprlib
import sys
from collections.abc import Mapping
from typing import Any, NoReturn

from schemas.errors import DamagedRecording

MAX_COUNT = 1 << 40
"""No step or number of steps in a recording is beyond it."""

MAX_JSON_BYTES = 64 << 20
"""A larger text is refused before it is parsed: as objects it may take 30 times as much memory."""

MAX_DEPTH = 64
"""Of lists and objects within each other; what handles them later may be recursive."""


_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxlist, _REPR.maxdict, _REPR.maxstring, _REPR.maxlong, _REPR.maxother = 2, 4, 2, 60, 40, 40


def load(name: str, text: str | bytes) -> dict[str, Any]:
    """A JSON object; DamagedRecording where the text is none. NaN and Infinity are not JSON."""
    if len(text) > MAX_JSON_BYTES:
        raise DamagedRecording(f"{name} has {len(text)} bytes; at most {MAX_JSON_BYTES} are read")
    try:
        record = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DamagedRecording(f"{name} is not JSON: {str(error) or type(error).__name__}") from None
    if not isinstance(record, dict):
        raise DamagedRecording(f"{name} is not a JSON object")
    _check_depth(name, record)
    return record


def _check_depth(name: str, record: dict[str, Any]) -> None:
    level: list[Any] = [record]
    for _ in range(MAX_DEPTH):
        parts = (part.values() if isinstance(part, dict) else part for part in level)
        level = [value for part in parts for value in part if isinstance(value, (dict, list))]
        if not level:
            return
    raise DamagedRecording(f"{name} has lists or objects more than {MAX_DEPTH} deep within each other")


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


def flag(record: Mapping[str, Any], key: str) -> bool:
    """True or false; false where the key is missing."""
    value = record.get(key, False)
    if not isinstance(value, bool):
        raise DamagedRecording(f"{key} is neither true nor false: {_short(value)}")
    return value


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
    if not good or not all(type(x) in (int, float) and abs(x) <= sys.float_info.max for x in value):
        raise DamagedRecording(f"{what} is not a list of {size} finite numbers: {_short(value)}")
    return tuple(float(x) for x in value)


def _short(value: Any) -> str:
    return "a huge number" if isinstance(value, int) and abs(value) >= 10**30 else _REPR.repr(value)
