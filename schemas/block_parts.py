"""Arrays to messages, bit for bit, in parts that are written one behind the other.

A packed repeated number is tag, length, little-endian bytes; protobuf lets fields follow each other in any order. So a
block is its small fields, serialised as usual, followed by the array's own bytes: no Python number is ever made.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import wire
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.mcap.writer import Part
from gpusimbench.schemas.messages import message_class

STATE = "gsb.v1.StateBlock"
ACTION = "gsb.v1.ActionBlock"
FINGERPRINT = "gsb.v1.FingerprintBlock"

ARRAY_FIELDS = {"data": "<f4", "data64": "<f8", "hashes": "<u8"}
"""Fields that hold whole arrays, packed, and their dtypes."""

RAW, PACKED, GENERATED = 0, 1, 2
"""Of gsb.v1.Encoding: the array as it is; packed; none, since a generator draws it again."""


def little_endian(array: NDArray[Any]) -> NDArray[Any]:
    """The array, C-contiguous and little-endian; no copy where it is so already."""
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))


def raw_bytes(array: NDArray[Any]) -> memoryview:
    """The bytes of a contiguous array, without a copy."""
    return array.reshape(-1).view(np.uint8).data


def array_head(name: str, array: NDArray[Any]) -> bytes:
    """What a message of that name has ahead of an array's own bytes: the tag of the field, and the length.

    ValueError where the message has no field for numbers of this kind.
    """
    of_dtype = {dtype: field for field, dtype in ARRAY_FIELDS.items()}
    by_name = message_class(name).DESCRIPTOR.fields_by_name
    field = by_name.get(of_dtype.get(array.dtype.newbyteorder("<").str, ""))
    if field is None:
        raise ValueError(f"states and actions are float32 or float64, not {array.dtype}")
    return wire.delimited_head(field.number, array.nbytes)


def state_parts(
    array: NDArray[Any], *, first_step: int, stride: int, env_start: int, sim_time_ns: int
) -> tuple[Part, Part]:
    """A StateBlock from an array [step, env, item, width]: its small fields, and the array's own bytes with their CRC.

    The array is not copied where it is contiguous and little-endian, and is not to change before it is written.
    """
    sides = ("steps", "envs", "items", "width")
    return _parts(STATE, array, sides, first_step=first_step, stride=stride, env_start=env_start,
                  sim_time_ns=sim_time_ns)  # fmt: skip


def action_parts(
    array: NDArray[Any], *, first_step: int, stride: int, env_start: int, sim_time_ns: int
) -> tuple[Part, Part]:
    """An ActionBlock from an array [step, env, width], as of `state_parts`."""
    sides = ("steps", "envs", "width")
    return _parts(ACTION, array, sides, first_step=first_step, stride=stride, env_start=env_start,
                  sim_time_ns=sim_time_ns)  # fmt: skip


def generated_action(parts: tuple[Part, Part], streams: Streams, env_start: int) -> bytes:
    """The ActionBlock of these parts, as of `action_parts`, without its array, which a generator draws again.

    streams  of its environments, the first of which is env_start
    """
    head, array = parts
    number = message_class(ACTION).DESCRIPTOR.fields_by_name["data"].number
    small = bytes(head.data).removesuffix(wire.delimited_head(number, len(array.data)))
    usual = Streams.usual(len(streams.env), env_start)
    stored = message_class(ACTION)(
        encoding=GENERATED,
        stream_env=streams.env.tolist() if (streams.env != usual.env).any() else (),
        stream_begun=streams.begun.tolist() if streams.begun.any() else (),
    )
    return small + bytes(stored.SerializeToString())


def _parts(name: str, array: NDArray[Any], sides: Sequence[str], **small: int) -> tuple[Part, Part]:
    array = little_endian(array)
    payload = raw_bytes(array)
    crc = zlib.crc32(payload)
    header = message_class(name)(**dict(zip(sides, array.shape, strict=True)), **small, crc32=crc)
    return Part(header.SerializeToString() + array_head(name, array)), Part(payload, crc)


def encode_fingerprints(hashes: NDArray[np.uint64], **where: int) -> bytes:
    """A serialised FingerprintBlock of what `fingerprint_parts` takes."""
    return b"".join(part.data for part in fingerprint_parts(hashes, **where))


def fingerprint_parts(hashes: NDArray[np.uint64], **where: int) -> tuple[Part, Part]:
    """A FingerprintBlock from hashes [step, env], as of `state_parts`; where: first_step, stride and env_start."""
    steps, envs = hashes.shape
    header = message_class(FINGERPRINT)(steps=steps, envs=envs, **where)
    payload = raw_bytes(little_endian(hashes))
    return Part(header.SerializeToString() + array_head(FINGERPRINT, hashes)), Part(payload, zlib.crc32(payload))
