"""Fields of protobuf messages as bytes."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas import wire

NUMBERS = st.integers(1, 2**29 - 1)
FIELDS = st.one_of(
    st.tuples(NUMBERS, st.just(wire.VARINT), st.integers(0, 2**64 - 1)),
    st.tuples(NUMBERS, st.just(wire.LENGTH_DELIMITED), st.binary(max_size=300)),
    st.tuples(NUMBERS, st.just(1), st.floats(allow_nan=False)),
    st.tuples(NUMBERS, st.just(5), st.floats(allow_nan=False, width=32)),
)


def encoded(number: int, kind: int, value: int | float | bytes) -> bytes:
    """A field with its tag."""
    if isinstance(value, bytes):
        return wire.delimited_head(number, len(value)) + value
    tag = wire.varint(number << 3 | kind)
    return tag + (wire.varint(int(value)) if kind == wire.VARINT else struct.pack("<d" if kind == 1 else "<f", value))


@given(st.lists(FIELDS, max_size=6))
def test_fields_are_those_that_were_written(written: list[tuple[int, int, int | float | bytes]]) -> None:
    """Return number, kind and content of every field, and all bytes of the message."""
    data = b"".join(encoded(*field) for field in written)
    found = list(wire.fields(memoryview(data)))
    assert [(one.number, one.kind) for one in found] == [field[:2] for field in written]
    for one, (_, kind, value) in zip(found, written, strict=True):
        assert one.value == (value if kind == wire.VARINT else 0)
        assert bytes(one.payload) == (value if isinstance(value, bytes) else b"")
    assert b"".join(one.whole for one in found) == data


@given(FIELDS.filter(lambda field: field[1] != wire.VARINT), st.integers(1, 400))
def test_a_message_that_ends_within_a_field(field: tuple[int, int, int | float | bytes], short: int) -> None:
    """Raise where the last field is cut, wherever."""
    whole = encoded(*field)
    with pytest.raises(ValueError):
        list(wire.fields(memoryview(whole[: max(1, len(whole) - short)])))


@given(NUMBERS, st.binary(max_size=400), st.binary(max_size=3))
def test_the_size_of_a_field(number: int, payload: bytes, behind: bytes) -> None:
    """Tell how long a field is by its head alone, whatever follows it."""
    head = wire.delimited_head(number, len(payload))
    assert wire.delimited_size(memoryview(head + payload + behind)) == len(head) + len(payload)
    assert wire.delimited_size(memoryview(head)) == len(head) + len(payload)
    assert wire.delimited_size(memoryview(encoded(number, wire.VARINT, len(payload)))) is None
    assert wire.delimited_size(memoryview(head[:1] if len(head) > 2 else b"")) is None
