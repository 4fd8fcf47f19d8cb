"""Messages to arrays, bit for bit: what block_parts.py makes, read back, checked, and packed or unpacked.

A block is its small fields followed by the array's own bytes. Blocks of states may hold their array packed instead
(schemas.packing), and blocks of actions none, where a generator draws it again (schemas.action_generator).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas import packing, wire
from gpusimbench.schemas.action_generator import Generator, Streams
from gpusimbench.schemas.block_parts import (
    ACTION,
    ARRAY_FIELDS,
    FINGERPRINT,
    GENERATED,
    PACKED,
    RAW,
    STATE,
    array_head,
    raw_bytes,
)
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap import decompression
from gpusimbench.schemas.mcap.crc import second
from gpusimbench.schemas.mcap.writer import Buffer
from gpusimbench.schemas.messages import message_class

STATE_HEAD_BYTES = 256
"""In which the small fields of a StateBlock have room."""

_ENCODINGS = {STATE: (RAW, PACKED), ACTION: (RAW, GENERATED), FINGERPRINT: (RAW,)}
_WORDS: dict[int, np.dtype[Any]] = {4: np.dtype("<f4"), 8: np.dtype("<f8")}
_MOST_DRAWN = 128 << 20  # bytes of a block of actions: a recorder's block has 50 steps of a 64th of the environments
_STREAMS = ("stream_env", "stream_begun")  # of an ActionBlock, fixed32
# the fields that say how an array is stored
_STORAGE = ("encoding", "packed", "data", "data64", "word_bytes", *_STREAMS)


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
    word_bytes: int = 0
    crc32: int | None = None


_SMALL = frozenset(field.name for field in fields(BlockHeader))


def _header(values: dict[str, int]) -> BlockHeader:
    return BlockHeader(**{name: value for name, value in values.items() if name in _SMALL})


@dataclass(frozen=True)
class _Scanned:
    """A message's small fields, and its array where it is; nothing is copied.

    field    name of the field that holds the array, empty without one
    array    its bytes
    packed   bytes of the array in another encoding
    streams  bytes of the fields of _STREAMS that are there
    before   bytes of the message ahead of the array where that ends it; None where it does not
    """

    header: BlockHeader
    field: str
    array: memoryview
    packed: memoryview
    streams: dict[str, memoryview]
    before: int | None


def _scan(name: str, data: memoryview, *, again: bool = False) -> _Scanned:
    """Find a message's parts.

    again  the message was repacked already: what is still not one packed array is no array of this field at all
    """
    by_number = message_class(name).DESCRIPTOR.fields_by_number
    values: dict[str, int] = {}
    streams: dict[str, memoryview] = {}
    array, payload, packed = "", memoryview(b""), memoryview(b"")
    position, end = 0, -1  # of the fields so far; of the array
    try:
        for found in wire.fields(data):
            position += len(found.whole)
            field = by_number.get(found.number)
            if field is None:
                continue
            if found.kind == wire.VARINT:
                values[field.name] = found.value
            elif field.name in ARRAY_FIELDS:
                if array or found.kind != wire.LENGTH_DELIMITED:
                    return _scan(name, _repacked(name, data, again), again=True)
                array, payload, end = field.name, found.payload, position
            elif field.name == "packed":
                packed = found.payload
            elif field.name in _STREAMS:
                streams[field.name] = found.payload
    except ValueError:
        raise DamagedRecording(f"a {name} message is cut short or no protobuf") from None
    header = _header(values)
    before = len(data) - len(payload) if end == len(data) and not again else None
    return _Scanned(header, array, payload, packed, streams, before)


def _repacked(name: str, data: memoryview, again: bool) -> memoryview:
    if again:
        raise DamagedRecording(f"a {name} message has two arrays, or an array of another type than its field")
    # Another writer may have split the array or left it unpacked, as protobuf allows; the library merges both.
    try:
        message = message_class(name).FromString(bytes(data))
    except Exception as error:  # protobuf's DecodeError differs between its backends
        raise DamagedRecording(f"a {name} message cannot be parsed: {error}") from None
    return memoryview(message.SerializeToString())


def _decode(
    name: str, data: bytes | memoryview, shape: Callable[[BlockHeader], tuple[int, ...]], crc: int | None = None,
    draw: Callable[[_Scanned], NDArray[Any]] | None = None,
) -> Any:  # fmt: skip
    scanned = _scan(name, memoryview(data))
    header = scanned.header
    _check_size(name, scanned, shape(header))
    try:
        if header.encoding == PACKED:
            array = packing.unpack(scanned.packed, shape(header), _dtype(scanned))
        elif header.encoding == GENERATED and draw is not None:
            array = draw(scanned)
        else:
            array = np.frombuffer(scanned.array, dtype=_dtype(scanned)).reshape(shape(header))
    except ValueError as error:  # also numpy's, of an array without numbers whose other sides are too many
        raise DamagedRecording(f"the {name} at step {header.first_step} cannot be read: {error}") from None
    array.flags.writeable = False
    claimed = header.crc32 if header.encoding != GENERATED else header.crc32 or 0  # what is drawn is always checked
    if claimed is not None and _array_crc(scanned, data, array, crc) != claimed:
        raise DamagedRecording(f"the {name} at step {header.first_step} fails its CRC")
    return header, array


def _array_crc(scanned: _Scanned, data: bytes | memoryview, array: NDArray[Any], crc: int | None) -> int:
    if crc is None or scanned.before is None or scanned.header.encoding != RAW:
        return zlib.crc32(raw_bytes(array))
    return second(crc, zlib.crc32(memoryview(data)[: scanned.before]), len(scanned.array))


def _dtype(scanned: _Scanned) -> np.dtype[Any]:
    if scanned.header.encoding in (RAW, GENERATED):
        return np.dtype(ARRAY_FIELDS.get(scanned.field, "<f4"))
    if scanned.header.word_bytes not in _WORDS:
        raise DamagedRecording(f"a packed block has numbers of {scanned.header.word_bytes} bytes, neither 4 nor 8")
    return _WORDS[scanned.header.word_bytes]


def _check_size(name: str, scanned: _Scanned, shape: tuple[int, ...]) -> int:
    # bytes of the array, borne out by what the message holds
    encoding = scanned.header.encoding
    if encoding not in _ENCODINGS[name]:
        raise DamagedRecording(
            f"a block uses encoding {encoding}, which this version does not read; update gpusimbench"
        )
    size = math.prod(shape) * _dtype(scanned).itemsize
    if encoding == PACKED:
        try:
            packing.check_frame(scanned.packed, size)
        except ValueError as error:
            raise DamagedRecording(f"a packed {name} message of shape {shape} is damaged: {error}") from None
    elif size != len(scanned.array) and encoding == RAW:
        raise DamagedRecording(
            f"a {name} message announces an array of shape {shape}, {size} bytes, and holds {len(scanned.array)}"
        )
    return size


def decode_state(data: bytes | memoryview, *, crc: int | None = None) -> tuple[BlockHeader, NDArray[Any]]:
    """Header and read-only array [step, env, item, width] of a StateBlock; its CRC is verified.

    crc  of `data`, where it is known: the array's then follows from it, and the array is not read for it

    The array is a view of `data` where it is not packed. Raises DamagedRecording where sizes disagree, the CRC does not
    match, or the encoding is not known.
    """
    result: tuple[BlockHeader, NDArray[Any]] = _decode(STATE, data, _state_shape, crc)
    return result


def state_header(data: bytes | memoryview) -> BlockHeader:
    """The small fields of a StateBlock; its array is not looked at."""
    return _scan(STATE, memoryview(data)).header


def state_header_in(head: memoryview, size: int) -> BlockHeader | None:
    """The small fields of a StateBlock from its first bytes; None where others may follow.

    size  of the whole message
    """
    by_number = message_class(STATE).DESCRIPTOR.fields_by_number
    values: dict[str, int] = {}
    position = 0
    with suppress(ValueError):  # the array is cut short
        for found in wire.fields(head):
            position += len(found.whole)
            field = by_number.get(found.number)
            if field is None or found.kind != wire.VARINT:
                return None
            values[field.name] = found.value
    array = wire.delimited_size(head[position:])
    if array is None or position + array != size:
        return None
    return _header(values)


def state_bytes(data: bytes | memoryview) -> int:
    """Bytes of a StateBlock's array, which is not unpacked; DamagedRecording where the message cannot hold them."""
    scanned = _scan(STATE, memoryview(data))
    return _check_size(STATE, scanned, _state_shape(scanned.header))


def pack_state(data: bytes | memoryview, *, level: int = packing.DEFAULT_LEVEL) -> bytes:
    """The same StateBlock with its array packed; with the array as it is where packing would not make it smaller.

    Whatever else the message holds stays as it is. The array's CRC is verified. level: see schemas.packing.pack.
    """
    _, array = decode_state(data)
    frame = packing.pack(array, level=level)
    stored = message_class(STATE)(encoding=PACKED, word_bytes=array.dtype.itemsize, packed=frame)
    packed, unpacked = _without_array(STATE, data) + bytes(stored.SerializeToString()), unpack_state(data)
    return packed if len(packed) < len(unpacked) else unpacked


def unpack_state(data: bytes | memoryview) -> bytes:
    """The same StateBlock with its array as it is; the inverse of pack_state."""
    return b"".join(_with_array(STATE, data, decode_state(data)[1]))


def _with_array(name: str, data: bytes | memoryview, array: NDArray[Any]) -> tuple[Buffer, Buffer, Buffer]:
    return _without_array(name, data), array_head(name, array), raw_bytes(array)


def _without_array(name: str, data: bytes | memoryview) -> bytes:
    by_name = message_class(name).DESCRIPTOR.fields_by_name
    storage = {by_name[field].number for field in _STORAGE if field in by_name}
    return b"".join(field.whole for field in wire.fields(memoryview(data)) if field.number not in storage)


def _state_shape(header: BlockHeader) -> tuple[int, ...]:
    return header.steps, header.envs, header.items, header.width


def decode_action(
    data: bytes | memoryview, generator: Generator | None = None, *, most: int = decompression.MAX_BYTES
) -> tuple[BlockHeader, NDArray[Any]]:
    """Header and read-only array [step, env, width] of an ActionBlock; its CRC is verified.

    generator  that draws the array again where the block has none
    most       environments times steps that are drawn; DamagedRecording where a block announces more
    """
    result: tuple[BlockHeader, NDArray[Any]] = _decode(
        ACTION, data, lambda h: (h.steps, h.envs, h.width), draw=lambda scanned: _drawn(scanned, generator, most)
    )
    return result


def raw_action(
    data: bytes | memoryview, generator: Generator | None, *, most: int = decompression.MAX_BYTES
) -> tuple[BlockHeader, tuple[Buffer, ...]]:
    """Header of an ActionBlock, and the same block with its array as it is, in parts: digests are of these bytes."""
    header = _scan(ACTION, memoryview(data)).header
    if header.encoding == RAW:
        return header, (data,)
    return header, _with_array(ACTION, data, decode_action(data, generator, most=most)[1])


def _drawn(scanned: _Scanned, generator: Generator | None, most: int) -> NDArray[np.float32]:
    # ValueError where the block is none that a recorder writes; nothing of its size is allocated before that is known
    header = scanned.header
    if generator is None:
        raise ValueError("its channel names no generator of the actions")
    rows, width = header.steps * header.envs, len(generator.actions.joints)
    if header.width != width or not 0 < rows <= most or 4 * rows * width > _MOST_DRAWN:
        raise ValueError(f"it announces {rows} times {header.width} numbers of a generator, more than may be drawn")
    if header.first_step + header.steps > 1 << 32 or header.env_start + header.envs > 1 << 32 or header.stride > 1:
        raise ValueError("it has steps or environments that a generator does not count")
    usual = Streams.usual(header.envs, header.env_start)
    env, begun = (
        np.frombuffer(scanned.streams[name], dtype="<u4") if scanned.streams.get(name) else otherwise
        for name, otherwise in zip(_STREAMS, (usual.env, usual.begun), strict=True)
    )
    if len(scanned.array) or not len(env) == len(begun) == header.envs:
        raise ValueError("it has an array besides its generator, or streams of other environments than its own")
    return generator.draw(Streams(env, begun), header.first_step, header.steps)


def decode_fingerprints(data: bytes | memoryview) -> tuple[BlockHeader, NDArray[np.uint64]]:
    """Header and hashes [step, env] of a FingerprintBlock."""
    result: tuple[BlockHeader, NDArray[np.uint64]] = _decode(FINGERPRINT, data, lambda h: (h.steps, h.envs))
    return result
