"""Messages of protobuf as bytes: their fields in place, without an object for any number."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

VARINT = 0
LENGTH_DELIMITED = 2
FIXED = {1: 8, 5: 4}
"""Wire types of numbers of fixed size, and their bytes."""


class Field(NamedTuple):
    """A field of a message.

    number   of the field
    kind     wire type
    value    of a varint; 0 for the other kinds
    payload  of a length-delimited field; empty for the other kinds
    whole    the field with its tag
    """

    number: int
    kind: int
    value: int
    payload: memoryview
    whole: memoryview


def varint(value: int) -> bytes:
    """A number as a varint."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def delimited_head(number: int, size: int) -> bytes:
    """Tag and length of a length-delimited field; its bytes follow."""
    return varint(number << 3 | LENGTH_DELIMITED) + varint(size)


def delimited_size(data: memoryview) -> int | None:
    """Bytes of the length-delimited field that `data` begins with, tag and length included; None where it is none."""
    try:
        tag, position = _read_varint(data, 0)
        size, position = _read_varint(data, position)
    except ValueError:
        return None
    return position + size if tag & 7 == LENGTH_DELIMITED else None


def fields(data: memoryview) -> Iterator[Field]:
    """The fields of a message in their order; ValueError where the bytes are none, or end in the middle of a field."""
    position, nothing = 0, data[:0]
    while position < len(data):
        begin = position
        tag, position = _read_varint(data, position)
        kind, value, payload = tag & 7, 0, nothing
        if kind == VARINT:
            value, position = _read_varint(data, position)
        elif kind == LENGTH_DELIMITED:
            size, position = _read_varint(data, position)
            payload = data[position : position + size]
            position += size
        elif kind in FIXED:
            position += FIXED[kind]
        else:
            raise ValueError(f"wire type {kind}")
        if position > len(data):
            raise ValueError("cut short")
        yield Field(tag >> 3, kind, value, payload, data[begin:position])


def _read_varint(data: memoryview, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        if position >= len(data) or shift > 63:
            raise ValueError("a varint that does not end")
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
