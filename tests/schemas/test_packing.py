"""Packed blocks give back every bit, and cost a reader no more than they are allowed to."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gpusimbench.schemas.blocks import decode_state, pack_state, state_bytes, state_header, unpack_state
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.messages import enum_values, message_class
from gpusimbench.schemas.packing import LEVELS, pack, unpack
from tests.encoded import announcing, encode_state
from tests.limits import next_to_no_memory

_WORDS = {4: np.dtype("<u4"), 8: np.dtype("<u8")}


@st.composite
def any_bits(draw: Any, min_side: int = 0) -> Any:
    """Arrays [step, env, item, width] of any bit pattern, also without steps, environments or items."""
    size = draw(st.sampled_from([4, 8]))
    shape = draw(hnp.array_shapes(min_dims=4, max_dims=4, min_side=min_side, max_side=6))
    return draw(hnp.arrays(_WORDS[size], shape)).view(f"<f{size}")


def _block(array: Any) -> bytes:
    return encode_state(array, first_step=3, stride=2, env_start=5, sim_time_ns=7)


def _smooth(steps: int = 50) -> Any:
    """Something that moves as bodies do."""
    time = np.arange(steps)[:, None, None, None] * 0.01
    return (np.cos(time + np.arange(24).reshape(1, 4, 2, 3)) * 0.1).astype("<f4")


@given(any_bits(), st.sampled_from([1, 3, 19]))
def test_round_trip(array: Any, level: int) -> None:
    """Return the bits of any array of any shape, NaN payloads and signed zeros included."""
    found = unpack(memoryview(pack(array, level=level)), array.shape, array.dtype)
    assert found.dtype == array.dtype
    assert found.shape == array.shape
    assert found.tobytes() == array.tobytes()


@given(any_bits(min_side=1))
def test_the_definition_of_the_schema(array: Any) -> None:
    """Decode, number by number, as the comments of the .proto file say, what another reader would have to."""
    size, (steps, *rest) = array.dtype.itemsize, array.shape
    content = zstandard.ZstdDecompressor().decompress(pack(array))
    series = len(content) // size // steps
    words = [
        [sum(content[b * series * steps + s * steps + i] << 8 * b for b in range(size)) for i in range(steps)]
        for s in range(series)
    ]
    modulus = 1 << 8 * size
    for row in words:
        for i in range(1, steps):
            difference = row[i] >> 1 if row[i] % 2 == 0 else -(row[i] + 1 >> 1)
            row[i] = (row[i - 1] + difference) % modulus
    found = np.array(words, dtype=_WORDS[size]).reshape(*rest, steps)
    assert np.moveaxis(found, -1, 0).tobytes() == array.tobytes()


@given(any_bits())
def test_a_message_and_back(array: Any) -> None:
    """Give the very message back that was packed, and read both alike."""
    raw = _block(array)
    packed = pack_state(raw)
    assert len(packed) <= len(raw)
    assert unpack_state(packed) == raw
    for data in (raw, packed):
        header, found = decode_state(data)
        assert found.tobytes() == array.tobytes()
        assert not found.flags.writeable
        assert (header.first_step, header.stride, header.env_start, header.sim_time_ns) == (3, 2, 5, 7)
        assert state_bytes(data) == array.nbytes


def test_it_is_smaller_and_says_how() -> None:
    """Pack what moves smoothly to less than plain compression does, and declare the encoding and the size of a word."""
    array = _smooth()
    packed = pack_state(_block(array))
    assert len(packed) < 0.8 * len(zstandard.ZstdCompressor(level=3).compress(array.tobytes()))
    header = state_header(packed)
    assert header.encoding == enum_values("gsb.v1.Encoding")["ENCODING_DELTA_SHUFFLE_ZSTD"] == 1
    assert header.word_bytes == 4
    assert message_class("gsb.v1.StateBlock").DESCRIPTOR.fields_by_name["word_bytes"].number == 14


def test_levels_give_the_same_array() -> None:
    """Pack anew at any level, also what is packed already."""
    raw = _block(_smooth())
    for level in (LEVELS[0], LEVELS[-1]):
        assert unpack_state(pack_state(pack_state(raw), level=level)) == raw


def test_what_cannot_be_smaller_stays_raw() -> None:
    """Leave noise as it is: any reader gets it."""
    noise = np.random.default_rng(1).integers(0, 2**32, (5, 2, 3, 3), dtype="<u4").view("<f4")
    assert pack_state(_block(noise)) == _block(noise)


def test_fields_of_a_later_version_survive() -> None:
    """Keep what this version does not know, both ways."""
    later = _block(_smooth()) + b"\xfa\x06\x03abc"  # field 111
    packed = pack_state(later)
    assert b"\xfa\x06\x03abc" in packed
    assert message_class("gsb.v1.StateBlock").FromString(unpack_state(packed)) == (
        message_class("gsb.v1.StateBlock").FromString(later)
    )


def _packed(frame: bytes, shape: tuple[int, int, int, int], **changes: Any) -> bytes:
    steps, envs, items, width = shape
    message = message_class("gsb.v1.StateBlock")(
        steps=steps, envs=envs, items=items, width=width, packed=frame, **{"encoding": 1, "word_bytes": 4, **changes}
    )
    return bytes(message.SerializeToString())


_SMALL = zstandard.ZstdCompressor(level=1, write_checksum=False).compress(b"\x07" * 48)
_STREAM = zstandard.ZstdCompressor(write_content_size=False).compress(b"\x07" * 48)


def test_the_frames_of_these_tests_are_frames() -> None:
    """Read the frame with its own size in eight bytes, so that the refusals below are for the size alone."""
    array = unpack(memoryview(announcing(_SMALL, 48)), (2, 1, 2, 3), np.dtype("<f4"))
    assert array.shape == (2, 1, 2, 3)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (_packed(_SMALL, (2, 1, 2, 4)), "announces 48 bytes instead of 64"),
        (_packed(announcing(_SMALL, 1 << 30), (2, 1, 2, 3)), "announces 1073741824 bytes instead of 48"),
        (_packed(announcing(_SMALL, 1 << 29), (1 << 13, 1 << 8, 1 << 4, 4), crc32=0), "more than its"),
        (_packed(_SMALL, (2**31, 2**31, 2**31, 3)), "more than its"),
        (_packed(announcing(_SMALL, 64), (2, 1, 2, 4)), "cannot be decompressed"),
        (_packed(_STREAM, (2, 1, 2, 3)), "announces no bytes"),
        (_packed(_SMALL + b"more", (2, 1, 2, 3)), "cannot be decompressed"),
        (_packed(_SMALL[:-3], (2, 1, 2, 3)), "cannot be decompressed"),
        (_packed(b"", (2, 1, 2, 3)), "no Zstandard frame"),
        (_packed(b"nothing of the kind", (2, 1, 2, 3)), "no Zstandard frame"),
        (_packed(_SMALL, (2, 1, 2, 3), word_bytes=3), "neither 4 nor 8"),
        (_packed(_SMALL, (2, 1, 2, 3), word_bytes=0), "neither 4 nor 8"),
        (_packed(_SMALL, (2, 1, 2, 3), crc32=1), "CRC"),
        (_packed(_SMALL, (2, 1, 2, 3), encoding=7), "encoding 7"),
        (_packed(pack(np.zeros((0, 1), "<f4")), (2**31, 0, 2**31, 2**31)), "cannot be read"),
        (_packed(b"", (2**31, 0, 2**31, 2**31), encoding=0), "cannot be read"),
    ],
)
def test_liars_are_refused_before_anything_is_allocated(data: bytes, message: str) -> None:
    """Name what is wrong with a packed block, and take next to no memory for finding out."""
    with next_to_no_memory(), pytest.raises(DamagedRecording, match=message):
        decode_state(data)


@given(st.data())
def test_a_changed_byte_is_noticed(data: Any) -> None:
    """Refuse a packed block whose frame was changed, or read the very array: a frame has bits that mean nothing."""
    array = _smooth()
    packed = bytearray(pack_state(_block(array)))
    position = data.draw(st.integers(len(packed) - len(pack(array)), len(packed) - 3))
    packed[position] ^= data.draw(st.integers(1, 255))
    try:
        found = decode_state(bytes(packed))[1]
    except DamagedRecording:
        return
    assert found.tobytes() == array.tobytes()
