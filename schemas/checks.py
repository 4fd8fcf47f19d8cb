"""Values out of a stranger's JSON: of the right kind and size, or an error that names them."""

from __future__ import annotations

import json
import reprlib
import sys
from collections.abc import Mapping
from itertools import chain
from typing import Any, NoReturn

from gpusimbench.schemas.errors import DamagedRecording

MAX_COUNT = 1 << 40
"""No step or number of steps in a recording is beyond it."""

MAX_JSON_BYTES = 32 << 20
"""Of the JSON documents of one file together; more are refused before they are parsed."""

MAX_JSON_VALUES = 1 << 20
"""The same of the values in them, keys not counted: a value of two bytes takes up to 250 bytes of memory as an object,
and each result that repeats it as much again. Four values say where an environment's origin is."""

MAX_JSON_TEXT = 1 << 20
"""Characters of one text or key in them: escaped for a page, one takes up to 20 bytes."""

MAX_DEPTH = 64
"""Of lists and objects within each other; what handles them later may be recursive."""


_REPR = reprlib.Repr()
_REPR.maxlevel, _REPR.maxlist, _REPR.maxdict, _REPR.maxstring, _REPR.maxlong, _REPR.maxother = 2, 4, 2, 60, 40, 40


class Budget:
    """What may be read of the JSON of one file, whose documents share it; one that is read again costs nothing."""

    def __init__(self) -> None:
        self._taken: dict[str, tuple[int, int]] = {}

    def take(self, name: str, text: str | bytes) -> None:
        """Add a document, before it is parsed; DamagedRecording where that is too much."""
        self._taken[name] = len(text), _most_values(text)
        size, values = map(sum, zip(*self._taken.values(), strict=True))
        if size > MAX_JSON_BYTES:
            raise DamagedRecording(
                f"{name} has {len(text)} bytes; at most {MAX_JSON_BYTES} are read of the JSON of a file"
            )
        if values > MAX_JSON_VALUES:
            raise DamagedRecording(
                f"{name} has {self._taken[name][1]} values; at most {MAX_JSON_VALUES} are read of the JSON of a file"
            )


def _most_values(text: str | bytes) -> int:
    # Every value but the first is the first of a list or an object, or follows a comma; marks in strings count, too.
    marks: tuple[Any, ...] = (",", "[", "{") if isinstance(text, str) else (b",", b"[", b"{")
    return 1 + sum(text.count(mark) for mark in marks)


def load(name: str, text: str | bytes, budget: Budget | None = None) -> dict[str, Any]:
    """A JSON object; DamagedRecording where the text is none. NaN and Infinity are not JSON.

    budget  of the file that the text is from; None where it is a file of its own
    """
    (budget or Budget()).take(name, text)
    try:
        record = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DamagedRecording(f"{name} is not JSON: {str(error) or type(error).__name__}") from None
    if not isinstance(record, dict):
        raise DamagedRecording(f"{name} is not a JSON object")
    _check_parts(name, record)
    return record


def _check_parts(name: str, record: dict[str, Any]) -> None:
    level: list[Any] = [record]
    for _ in range(MAX_DEPTH):
        inner: list[Any] = []
        for part in level:
            for value in chain(part, part.values()) if isinstance(part, dict) else part:
                if isinstance(value, (dict, list)):
                    inner.append(value)
                elif isinstance(value, str) and len(value) > MAX_JSON_TEXT:
                    raise DamagedRecording(
                        f"{name} has a text of {len(value)} characters; at most {MAX_JSON_TEXT} are read"
                    )
        level = inner
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


def number(record: Mapping[str, Any], key: str, low: float, high: float, default: float | None = None) -> float:
    """A finite number from low to high."""
    value = record.get(key, default)
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
