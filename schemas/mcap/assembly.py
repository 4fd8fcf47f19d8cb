"""Messages as the records of a file's data section: chunks, and the indexes of what is in them.

A large message is a chunk of its own, kept as the pieces that it consists of: nothing is joined or copied. Small
messages share a chunk. A CRC that is known already, such as that of an array, becomes part of those of its chunk and of
the data section without the bytes being read again.
"""

from __future__ import annotations

import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import NamedTuple

from gpusimbench.schemas.mcap.crc import combine
from gpusimbench.schemas.mcap.records import INDEX_ENTRY, Op

CHUNK_BYTES = 128 * 1024
"""From which on a message is a chunk of its own."""

TOGETHER_BYTES = 8 << 20
"""Of large messages, handed over in one call: each lets go of the interpreter's lock."""

_TOGETHER_PIECES = 512
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")

Buffer = bytes | bytearray | memoryview


class Part(NamedTuple):
    """Bytes of a message, flat, and their CRC-32 where it is known."""

    data: Buffer
    crc: int | None = None


class _Message(NamedTuple):
    channel: int
    log_time: int
    head: bytes
    parts: Sequence[Part]
    size: int  # of the whole record


class NextMessages(NamedTuple):
    """Where messages would begin, one of each of some channels, and what their records have beside their content.

    offset        in the file
    channels      number of each
    sequences     number of each message among those of its channel
    publish_time  [ns]
    """

    offset: int
    channels: list[int]
    sequences: list[int]
    publish_time: int


class Records(NamedTuple):
    """Whole records that follow each other in a data section.

    begin    offset of the first
    pieces   their bytes
    crc      of these
    indexes  a CHUNK_INDEX record for each chunk
    counts   messages by channel
    times    of the first and of the last message [ns]; None without messages
    """

    begin: int
    size: int
    pieces: Sequence[Buffer]
    crc: int
    indexes: Sequence[bytes]
    counts: dict[int, int]
    times: tuple[int, int] | None


def text_of(value: str) -> bytes:
    """A text with its length ahead."""
    data = value.encode()
    return _U32.pack(len(data)) + data


def record_of(opcode: int, content: bytes) -> bytes:
    """A record: its kind, its length, its content."""
    return struct.pack("<BQ", opcode, len(content)) + content


def _lz4(data: bytes) -> bytes:
    import lz4.frame

    packed: bytes = lz4.frame.compress(data)
    return packed


def _zstd(data: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor().compress(data)


COMPRESSIONS: dict[str, Callable[[bytes], bytes] | None] = {"none": None, "lz4": _lz4, "zstd": _zstd}
"""Of chunks."""


class Assembler(ABC):
    """Makes records of messages, from an offset of the file on.

    compression  a key of COMPRESSIONS
    """

    def __init__(self, offset: int, compression: str = "none") -> None:
        self._compression = "" if compression == "none" else compression
        self._compress = COMPRESSIONS[compression]
        self._offset = offset
        self._crc = 0  # of the records so far
        self._chunk_indexes: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._times: tuple[int, int] | None = None
        self._waiting: list[_Message] = []  # small messages of the open chunk
        self._waiting_bytes = 0
        self._queue: list[memoryview] = []  # whole records, the last before _offset
        self._queued = 0  # bytes of them

    def message(
        self, channel: int, data: Buffer | Sequence[Part], *, log_time: int, publish_time: int, sequence: int
    ) -> None:
        """Add a message: its bytes, or the parts that they consist of, which must not change before `flush`.

        log_time, publish_time  [ns]
        """
        parts = [Part(data)] if isinstance(data, (bytes, bytearray, memoryview)) else data
        size = 0
        for part in parts:
            size += len(part.data)
        head = _MESSAGE_HEAD.pack(Op.MESSAGE, 22 + size, channel, sequence, log_time, publish_time)
        message = _Message(channel, log_time, head, parts, len(head) + size)
        self._counts[channel] = self._counts.get(channel, 0) + 1
        first, last = self._times or (log_time, 0)
        self._times = min(first, log_time), max(last, log_time)
        if message.size >= CHUNK_BYTES:
            self._end_chunk()
            self._write_chunk([message], later=parts is data)
            return
        self._waiting.append(message)
        self._waiting_bytes += message.size
        if self._waiting_bytes >= CHUNK_BYTES:
            self._end_chunk()
            if parts is not data:  # whoever gives parts flushes soon
                self._hand_over()

    def flush(self) -> None:
        """Write the open chunk and what is held back, so that a crash loses nothing that was added."""
        self._end_chunk()
        self._hand_over()

    def _end_chunk(self) -> None:
        if self._waiting:
            waiting, self._waiting, self._waiting_bytes = self._waiting, [], 0
            self._write_chunk(waiting, later=True)

    def _write_chunk(self, messages: Sequence[_Message], *, later: bool) -> None:
        parts = [part for message in messages for part in (Part(message.head), *message.parts)]
        size = sum(message.size for message in messages)
        if len(messages) > 1:
            parts = [Part(b"".join(part.data for part in parts))]
        crc = 0
        for part in parts:
            crc = _following(crc, part)
        first, last = min(m.log_time for m in messages), max(m.log_time for m in messages)
        if self._compress is None:
            stored, stored_crc, stored_size = parts, crc, size
        else:
            packed = self._compress(b"".join(part.data for part in parts))
            stored, stored_crc, stored_size = [Part(packed)], zlib.crc32(packed), len(packed)
        fixed = struct.pack("<QQQI", first, last, size, crc) + text_of(self._compression) + _U64.pack(stored_size)
        head = struct.pack("<BQ", Op.CHUNK, len(fixed) + stored_size) + fixed
        begin, length = self._offset, len(head) + stored_size
        indexes = self._message_indexes(messages)
        places, position = [], begin + length
        for channel, index in indexes.items():
            places.append(struct.pack("<HQ", channel, position))
            position += len(index)
        index = b"".join(indexes.values())
        self._crc = combine(zlib.crc32(head, self._crc), stored_crc, stored_size)
        self._crc = zlib.crc32(index, self._crc)
        self._write([Part(head), *stored, Part(index)], later=later)
        content = (
            struct.pack("<QQQQ", first, last, begin, length)
            + _U32.pack(sum(map(len, places)))
            + b"".join(places)
            + _U64.pack(len(index))
            + text_of(self._compression)
            + struct.pack("<QQ", stored_size, size)
        )
        self._chunk_indexes.append(record_of(Op.CHUNK_INDEX, content))

    def _message_indexes(self, messages: Sequence[_Message]) -> dict[int, bytes]:
        # a record for each channel of a chunk: when its messages are of, and where in the chunk they are
        entries: dict[int, list[bytes]] = {}
        position = 0
        for message in messages:
            entries.setdefault(message.channel, []).append(INDEX_ENTRY.pack(message.log_time, position))
            position += message.size
        return {
            channel: record_of(Op.MESSAGE_INDEX, struct.pack("<HI", channel, 16 * len(found)) + b"".join(found))
            for channel, found in entries.items()
        }

    def _write(self, parts: Sequence[Part], *, later: bool = False) -> None:
        pieces = [memoryview(part.data) for part in parts if len(part.data)]
        size = sum(map(len, pieces))
        self._queue += pieces
        self._queued += size
        self._offset += size
        if not later or self._queued >= TOGETHER_BYTES or len(self._queue) >= _TOGETHER_PIECES:
            self._hand_over()

    @abstractmethod
    def _hand_over(self) -> None:
        """Do with the queue what is to be done, once it is long or complete."""


class Assembly(Assembler):
    """Records of messages that McapWriter.append adds to a file."""

    def _hand_over(self) -> None:
        """Keep all records."""

    def records(self) -> Records:
        """The records of all messages that were added."""
        self.flush()
        begin = self._offset - self._queued
        return Records(begin, self._queued, self._queue, self._crc, self._chunk_indexes, self._counts, self._times)


def _following(crc: int, part: Part) -> int:
    if part.crc is None:
        return zlib.crc32(part.data, crc)
    return combine(crc, part.crc, len(part.data))
