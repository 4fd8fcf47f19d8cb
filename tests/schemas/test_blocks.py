"""Arrays survive the format bit for bit, and damage is noticed."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpusimbench.schemas import wire
from gpusimbench.schemas.block_parts import encode_fingerprints
from gpusimbench.schemas.blocks import (
    STATE_HEAD_BYTES,
    decode_action,
    decode_fingerprints,
    decode_state,
    pack_state,
    state_bytes,
    state_header,
    state_header_in,
    unpack_state,
)
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.messages import message_class
from tests.encoded import encode_action, encode_state

_DTYPES = st.sampled_from(["<f4", "<f8", ">f4", ">f8"])


@st.composite
def any_bits(draw: Any, ndim: int) -> Any:
    """Arrays of any bit pattern: NaN payloads, infinities, subnormals and signed zeros included."""
    dtype = np.dtype(draw(_DTYPES))
    words = {4: np.uint32, 8: np.uint64}[dtype.itemsize]
    shape = draw(hnp.array_shapes(min_dims=ndim, max_dims=ndim, max_side=5))
    return draw(hnp.arrays(words, shape)).view(dtype)


@given(any_bits(4), st.integers(0, 2**40), st.integers(1, 2**20), st.integers(0, 2**24))
def test_state_round_trip(array: Any, first: int, stride: int, env: int) -> None:
    """Return the bits of any array, and its place."""
    data = encode_state(array, first_step=first, stride=stride, env_start=env, sim_time_ns=7)
    header, decoded = decode_state(data)
    assert decoded.tobytes() == array.astype(array.dtype.newbyteorder("<")).tobytes()
    assert decoded.shape == array.shape
    assert (header.first_step, header.stride, header.env_start, header.sim_time_ns) == (first, stride, env, 7)


@given(any_bits(4))
def test_generic_protobuf_reads_the_same(array: Any) -> None:
    """Give any protobuf reader the numbers under their declared type."""
    message = message_class("gsb.v1.StateBlock").FromString(
        encode_state(array, first_step=0, stride=1, env_start=0, sim_time_ns=0)
    )
    numbers = message.data if array.dtype.itemsize == 4 else message.data64
    native = array.astype(array.dtype.newbyteorder("="))
    assert np.array_equal(np.array(numbers, dtype=native.dtype).reshape(array.shape), native, equal_nan=True)
    assert (message.steps, message.envs, message.items, message.width) == array.shape


@given(any_bits(3))
def test_action_round_trip(array: Any) -> None:
    """Return the bits of actions."""
    _, decoded = decode_action(encode_action(array, first_step=3, stride=1, env_start=0, sim_time_ns=0))
    assert decoded.tobytes() == array.astype(array.dtype.newbyteorder("<")).tobytes()


@given(hnp.arrays(np.uint64, hnp.array_shapes(min_dims=2, max_dims=2)))
def test_fingerprint_round_trip(hashes: Any) -> None:
    """Return hashes as they were."""
    header, decoded = decode_fingerprints(encode_fingerprints(hashes, first_step=5, stride=2))
    assert np.array_equal(decoded, hashes)
    assert (header.first_step, header.stride) == (5, 2)


def _block(array: Any) -> bytes:
    return encode_state(array, first_step=0, stride=1, env_start=0, sim_time_ns=0)


def test_unpacked_and_split_arrays_are_read() -> None:
    """Accept the other encodings of a repeated field that protobuf allows."""
    array = np.arange(6, dtype="<f4").reshape(1, 1, 2, 3)
    packed = _block(array)
    number = message_class("gsb.v1.StateBlock").DESCRIPTOR.fields_by_name["data"].number
    head = packed[: -len(array.tobytes()) - 2]
    unpacked = head + b"".join(bytes([number << 3 | 5]) + struct.pack("<f", v) for v in array.ravel())
    split = head + b"".join(bytes([number << 3 | 2, 12]) + part.tobytes() for part in (array[0, 0, 0], array[0, 0, 1]))
    first_step = message_class("gsb.v1.StateBlock").DESCRIPTOR.fields_by_name["first_step"].number
    followed = packed + wire.varint(first_step << 3) + wire.varint(9)
    for data in (packed, unpacked, split, followed):
        for crc in (None, zlib.crc32(data)):  # of the array, told from that of the message where it ends the message
            assert np.array_equal(decode_state(data, crc=crc)[1], array)


@pytest.mark.parametrize("position", range(0, 60, 7))
def test_a_changed_byte_is_noticed(position: int) -> None:
    """Refuse a block of which any byte of the array was changed."""
    data = bytearray(_block(np.arange(24, dtype=np.float64).reshape(2, 1, 4, 3)))
    data[-1 - position] ^= 1
    with pytest.raises(DamagedRecording, match="CRC"):
        decode_state(bytes(data))


@given(st.binary(max_size=200))
@example(b"m\x00\x00\x00\x00\xb8\x00\x00")  # a field of doubles with four bytes
def test_garbage_is_refused(data: bytes) -> None:
    """Raise DamagedRecording, never anything else, on bytes that are no block."""
    for decode in (decode_state, decode_action, decode_fingerprints):
        try:
            decode(data)  # type: ignore[operator]
        except DamagedRecording:
            continue


def test_a_lying_header_allocates_nothing() -> None:
    """Refuse a shape that the bytes do not bear out."""
    message = message_class("gsb.v1.StateBlock")(steps=2**31, envs=2**31, items=2**31, width=3, data=[1.0])
    with pytest.raises(DamagedRecording, match="announces"):
        decode_state(message.SerializeToString())


def test_an_unknown_encoding_is_named() -> None:
    """Say that a newer version is needed for an encoding that this one does not know."""
    message = message_class("gsb.v1.StateBlock")(steps=1, envs=1, items=1, width=1, encoding=9, packed=b"x")
    with pytest.raises(DamagedRecording, match="encoding 9"):
        decode_state(message.SerializeToString())


def test_other_dtypes_are_refused() -> None:
    """Raise on numbers that the format has no field for."""
    with pytest.raises(ValueError, match="float32 or float64"):
        _block(np.zeros((1, 1, 1, 1), dtype=np.int32))


def test_a_field_of_another_wire_type_is_passed_over() -> None:
    """Read a packed block with a small field of a type that is not its own, as protobuf does: the field is unknown."""
    array = np.zeros((3, 2, 1, 3), np.float32)
    data = pack_state(encode_state(array, first_step=4, stride=1, env_start=0, sim_time_ns=0))
    steps = message_class("gsb.v1.StateBlock").DESCRIPTOR.fields_by_name["first_step"].number
    header, decoded = decode_state(data + wire.delimited_head(steps, 2) + b"ab")
    assert header.first_step == 4
    assert np.array_equal(decoded, array)


def test_a_head_alone_tells_the_small_fields() -> None:
    """Read the small fields of a block from its first bytes, where the array is all that follows."""
    array = np.ones((3, 2, 40, 3), np.float64)
    data = memoryview(encode_state(array, first_step=4, stride=5, env_start=6, sim_time_ns=7))
    head = state_header_in(data[:STATE_HEAD_BYTES], len(data))
    assert head == state_header(data)
    assert (head.steps, head.envs, head.items, head.width, head.stride) == (3, 2, 40, 3, 5)
    assert state_header_in(data[:STATE_HEAD_BYTES], len(data) + 1) is None
    assert state_header_in(data[:10], len(data)) is None
    for unknown in (wire.varint(99 << 3) + b"\x01", wire.delimited_head(1, 2) + b"ab"):  # another field, another type
        assert state_header_in(memoryview(unknown + data)[:STATE_HEAD_BYTES], len(unknown) + len(data)) is None
    assert state_bytes(data) == array.nbytes


def test_packing_is_undone() -> None:
    """Return the very bytes of a block that was packed and unpacked, and keep what would not get smaller."""
    small = encode_state(np.zeros((50, 2, 9, 3), np.float32), first_step=1, stride=1, env_start=0, sim_time_ns=2)
    packed = pack_state(small)
    assert len(packed) < len(small) / 10
    assert unpack_state(packed) == small
    noise = np.random.default_rng(0).integers(0, 2**32, size=(2, 1, 3, 3), dtype=np.uint32).view(np.float32)
    kept = encode_state(noise, first_step=1, stride=1, env_start=0, sim_time_ns=2)
    assert pack_state(kept) == kept
