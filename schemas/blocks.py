"""Arrays to messages and back, bit for bit.

A packed repeated number is tag, length, little-endian bytes; protobuf lets fields follow each other in any order. So a
block is its small fields, serialised as usual, followed by the array's own bytes: no Python number is ever made.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from schemas.errors import DamagedRecording
from schemas.mcap_writer import Part
from schemas.messages import message_class

_STATE = "gsb.v1.StateBlock"
_ACTION = "gsb.v1.ActionBlock"
_FINGERPRINT = "gsb.v1.FingerprintBlock"

ARRAY_FIELDS = {"data": "<f4", "data64": "<f8", "hashes": "<u8"}
"""Fields that hold whole arrays, packed, and their dtypes."""

# wire types of protobuf
_VARINT = 0
_LENGTH_DELIMITED = 2
_FIXED = {1: 8, 5: 4}


def little_endian(array: NDArray[Any]) -> NDArray[Any]:
    """The array, C-contiguous and little-endian; no copy where it is so already."""
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))


def raw_bytes(array: NDArray[Any]) -> memoryview:
    """The bytes of a contiguous array, without a copy."""
    return array.reshape(-1).view(np.uint8).data


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _before_array(header: Any, field: str, payload: memoryview) -> bytes:
    number = header.DESCRIPTOR.fields_by_name[field].number
    tag = _varint(number << 3 | _LENGTH_DELIMITED)
    return b"".join((header.SerializeToString(), tag, _varint(len(payload))))


def _with_array(header: Any, field: str, payload: memoryview) -> bytes:
    return _before_array(header, field, payload) + payload


def _data_field(array: NDArray[Any]) -> str:
    fields = {np.dtype("<f4"): "data", np.dtype("<f8"): "data64"}
    try:
        return fields[array.dtype]
    except KeyError:
        raise ValueError(f"states and actions are float32 or float64, not {array.dtype}") from None


def state_parts(
    array: NDArray[Any], *, first_step: int, stride: int, env_start: int, sim_time_ns: int
) -> tuple[Part, ...]:
    """A StateBlock from an array [step, env, item, width]: its small fields, and the array's own bytes with their CRC.

    The array is not copied where it is contiguous and little-endian, and is not to change before it is written.
    """
    array = little_endian(array)
    payload = raw_bytes(array)
    steps, envs, items, width = array.shape
    crc = zlib.crc32(payload)
    header = message_class(_STATE)(
        first_step=first_step, steps=steps, stride=stride, env_start=env_start, envs=envs, items=items,
        width=width, sim_time_ns=sim_time_ns, crc32=crc,
    )  # fmt: skip
    return Part(_before_array(header, _data_field(array), payload)), Part(payload, crc)


def encode_state(array: NDArray[Any], *, first_step: int, stride: int, env_start: int, sim_time_ns: int) -> bytes:
    """A serialised StateBlock from an array [step, env, item, width]."""
    parts = state_parts(array, first_step=first_step, stride=stride, env_start=env_start, sim_time_ns=sim_time_ns)
    return b"".join(part.data for part in parts)


def encode_action(array: NDArray[Any], *, first_step: int, stride: int, env_start: int, sim_time_ns: int) -> bytes:
    """A serialised ActionBlock from an array [step, env, width]."""
    array = little_endian(array)
    payload = raw_bytes(array)
    steps, envs, width = array.shape
    header = message_class(_ACTION)(
        first_step=first_step, steps=steps, stride=stride, env_start=env_start, envs=envs,
        width=width, sim_time_ns=sim_time_ns, crc32=zlib.crc32(payload),
    )  # fmt: skip
    return _with_array(header, _data_field(array), payload)


def encode_fingerprints(hashes: NDArray[np.uint64], *, first_step: int, stride: int, env_start: int = 0) -> bytes:
    """A serialised FingerprintBlock from hashes [step, env]."""
    hashes = little_endian(hashes)
    steps, envs = hashes.shape
    header = message_class(_FINGERPRINT)(
        first_step=first_step, steps=steps, stride=stride, env_start=env_start, envs=envs
    )
    return _with_array(header, "hashes", raw_bytes(hashes))


@dataclass(frozen=True)
class BlockHeader:
    """The small fields of a StateBlock, ActionBlock or FingerprintBlock; zero where a message has no such field."""

    first_step: int = 0
    steps: int = 0
    stride: int = 0
    env_start: int = 0
    envs: int = 0
    items: int = 0
    width: int = 0
    sim_time_ns: int = 0
    encoding: int = 0
    crc32: int | None = None


def _read_varint(data: memoryview, position: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
        shift += 7
        if shift > 63:
            raise IndexError


def _scan(name: str, data: memoryview, *, again: bool = False) -> tuple[BlockHeader, str, memoryview]:
    """Header, name of the array field and the array's bytes, in place; nothing is copied.

    again  the message was repacked already: what is still not one packed array is no array of this field at all
    """
    by_number = message_class(name).DESCRIPTOR.fields_by_number
    values: dict[str, int] = {}
    array, payload = "", memoryview(b"")
    position = 0
    try:
        while position < len(data):
            tag, position = _read_varint(data, position)
            field = by_number.get(tag >> 3)
            kind = tag & 7
            if kind == _VARINT:
                value, position = _read_varint(data, position)
                if field is not None:
                    values[field.name] = value
            elif kind == _LENGTH_DELIMITED:
                size, position = _read_varint(data, position)
                if size > len(data) - position:
                    raise IndexError
                if field is not None and field.name in ARRAY_FIELDS:
                    if array:
                        return _scan(name, _repacked(name, data, again), again=True)
                    array, payload = field.name, data[position : position + size]
                position += size
            elif kind in _FIXED and field is not None and field.name in ARRAY_FIELDS:
                return _scan(name, _repacked(name, data, again), again=True)
            elif kind in _FIXED:
                position += _FIXED[kind]
            else:
                raise IndexError
    except IndexError:
        raise DamagedRecording(f"a {name} message is cut short or no protobuf") from None
    known = {f.name for f in fields(BlockHeader)}
    return BlockHeader(**{k: v for k, v in values.items() if k in known}), array, payload


def _repacked(name: str, data: memoryview, again: bool) -> memoryview:
    if again:
        raise DamagedRecording(f"a {name} message has two arrays, or an array of another type than its field")
    # Another writer may have split the array or left it unpacked, as protobuf allows; the library merges both.
    try:
        message = message_class(name).FromString(bytes(data))
    except Exception as error:  # protobuf's DecodeError differs between its backends
        raise DamagedRecording(f"a {name} message cannot be parsed: {error}") from None
    return memoryview(message.SerializeToString())


def _decode(name: str, data: bytes | memoryview, shape: Callable[[BlockHeader], tuple[int, ...]]) -> Any:
    header, field, payload = _scan(name, memoryview(data))
    if header.encoding != 0:
        raise DamagedRecording(
            f"a block uses encoding {header.encoding}, which this version does not read; update gpusimbench"
        )
    dtype = np.dtype(ARRAY_FIELDS.get(field, "<f4"))
    sizes = shape(header)
    expected = math.prod(sizes) * dtype.itemsize
    if expected != len(payload):
        raise DamagedRecording(
            f"a {name} message announces an array of shape {sizes}, {expected} bytes, and holds {len(payload)}"
        )
    if header.crc32 is not None and zlib.crc32(payload) != header.crc32:
        raise DamagedRecording(f"the {name} at step {header.first_step} fails its CRC")
    return header, np.frombuffer(payload, dtype=dtype).reshape(sizes)


def decode_state(data: bytes | memoryview) -> tuple[BlockHeader, NDArray[Any]]:
    """Header and read-only array [step, env, item, width] of a StateBlock, a view of `data`; its CRC is verified.

    Raises DamagedRecording where sizes disagree, the CRC does not match, or the encoding is not known.
    """
    result: tuple[BlockHeader, NDArray[Any]] = _decode(_STATE, data, lambda h: (h.steps, h.envs, h.items, h.width))
    return result


def state_header(data: bytes | memoryview) -> BlockHeader:
    """The small fields of a StateBlock; its array is not looked at."""
    return _scan(_STATE, memoryview(data))[0]


def decode_action(data: bytes | memoryview) -> tuple[BlockHeader, NDArray[Any]]:
    """Header and read-only array [step, env, width] of an ActionBlock; its CRC is verified."""
    result: tuple[BlockHeader, NDArray[Any]] = _decode(_ACTION, data, lambda h: (h.steps, h.envs, h.width))
    return result


def decode_fingerprints(data: bytes | memoryview) -> tuple[BlockHeader, NDArray[np.uint64]]:
    """Header and hashes [step, env] of a FingerprintBlock."""
    result: tuple[BlockHeader, NDArray[np.uint64]] = _decode(_FINGERPRINT, data, lambda h: (h.steps, h.envs))
    return result
