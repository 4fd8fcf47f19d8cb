"""Whether a message of a file says what it should, numbers within what different machines make of a sine."""

from __future__ import annotations

import math
import reprlib
from typing import Any

_TOLERANCE = 1e-9  # of numbers up to 1, and relative to larger ones


_REPR = reprlib.Repr()
_REPR.maxstring = 100  # of a stranger


def difference(expected: Any, data: memoryview) -> str:
    """Where a serialised message first differs from the one expected, in words; empty where it does not."""
    if bytes(data) == expected.SerializeToString():
        return ""
    try:
        found = type(expected).FromString(bytes(data))
    except Exception as error:  # protobuf's DecodeError differs between its backends
        return f"it is no {expected.DESCRIPTOR.full_name}: {error}"
    return _first(expected, found, "")


def _first(expected: Any, found: Any, path: str) -> str:
    # as deep as the definitions, which are ours
    for field in expected.DESCRIPTOR.fields:
        name = f"{path}{field.name}"
        one, other = getattr(expected, field.name), getattr(found, field.name)
        if not field.is_repeated:
            pairs = [(name, one, other)]
        elif len(one) != len(other):
            return f"{name} has {len(other)} entries, not {len(one)}"
        else:
            pairs = [(f"{name}[{at}]", *pair) for at, pair in enumerate(zip(one, other, strict=True))]
        for where, wanted, there in pairs:
            if field.message_type is not None:
                if what := _first(wanted, there, f"{where}."):
                    return what
            elif not _same(wanted, there):
                return f"{where} is {_short(there)}, and should be {_short(wanted)}"
    return ""


def _short(value: Any) -> str:
    return repr(value) if isinstance(value, float) else _REPR.repr(value)


def _same(wanted: Any, there: Any) -> bool:
    if not isinstance(wanted, float) or not isinstance(there, float):
        return bool(wanted == there)
    if math.isnan(wanted) or math.isnan(there):
        return math.isnan(wanted) and math.isnan(there)
    if math.isinf(wanted) or math.isinf(there):  # a tolerance relative to it would take every number
        return wanted == there
    return abs(wanted - there) <= _TOLERANCE * max(1.0, abs(wanted))
