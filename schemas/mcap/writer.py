"""Writes MCAP files (https://mcap.dev/spec) whose messages are few and large.

A large message is a chunk of its own, handed to the operating system as the pieces that it consists of: nothing is
joined or copied. Small messages share a chunk. A CRC that is known already, such as that of an array, becomes part of
those of its chunk and of the data section without the bytes being read again.

Schemas and channels are records of the data section itself, ahead of the chunks that use them, so that a file that was
cut short is read from its beginning without a summary. What ``message`` was given as the bytes of a large message, and
all that came before it, has reached the operating system when it returns; large messages in parts are handed over
several together, at ``flush`` at the latest.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import NamedTuple

from gpusimbench.schemas.mcap.crc import combine
from gpusimbench.schemas.mcap.declarations import NewDeclarations
from gpusimbench.schemas.mcap.records import INDEX_ENTRY, MAGIC, Op, Record

_CHUNK_BYTES = 128 * 1024
_TOGETHER_BYTES = 8 << 20  # of large messages, handed over in one call: each lets go of the interpreter's lock
_TOGETHER_PIECES = 512
_MOST_PIECES = 1024  # that the operating system takes in one call (IOV_MAX of Linux and macOS)

_MESSAGE_HEAD = struct.Struct("<BQHIQQ")
_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")

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


class _Place(NamedTuple):
    offset: int
    head: bytes  # of the content, before the size of the data
    size: int  # of the data
    crc: int  # of the whole record


def _text(value: str) -> bytes:
    data = value.encode()
    return _U32.pack(len(data)) + data


def _text_map(values: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in values.items())
    return _U32.pack(len(data)) + data


def _record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _attachment(head: bytes, data: bytes) -> bytes:
    content = head + _U64.pack(len(data)) + data
    return _record(Op.ATTACHMENT, content + _U32.pack(zlib.crc32(content)))


def _lz4(data: bytes) -> bytes:
    import lz4.frame

    packed: bytes = lz4.frame.compress(data)
    return packed


def _zstd(data: bytes) -> bytes:
    import zstandard

    return zstandard.ZstdCompressor().compress(data)


COMPRESSIONS: dict[str, Callable[[bytes], bytes] | None] = {"none": None, "lz4": _lz4, "zstd": _zstd}
"""Of chunks."""


class McapWriter:
    """Writes one file, from its first byte to its footer.

    stream       open for writing, empty, without a buffer of its own; whoever opened it closes it
    profile      of the MCAP header
    library      of the MCAP header
    compression  a key of COMPRESSIONS

    OSError where the disk takes no more; the writer is of no use after that.
    """

    def __init__(self, stream: FileIO, *, profile: str, library: str, compression: str = "none") -> None:
        self._descriptor = stream.fileno()
        self._compression = "" if compression == "none" else compression
        self._compress = COMPRESSIONS[compression]
        self._offset = 0
        self._crc = 0  # of the data section so far
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._declared = NewDeclarations(Path("the file"))  # as a reader takes them
        self._chunk_indexes: list[bytes] = []
        self._attachment_indexes: list[bytes] = []
        self._attachments: dict[str, _Place] = {}
        self._metadata_indexes: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._first_time: int | None = None
        self._last_time = 0
        self._waiting: list[_Message] = []  # small messages of the open chunk
        self._waiting_bytes = 0
        self._queue: list[memoryview] = []  # whole records, the last before _offset
        self._queued = 0  # bytes of them
        self._append(MAGIC + _record(Op.HEADER, _text(profile) + _text(library)))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a schema; returns its number."""
        number = len(self._schemas) + 1
        content = _U16.pack(number) + _text(name) + _text(encoding) + _U32.pack(len(data)) + data
        self._schemas.append(_record(Op.SCHEMA, content))
        self._append(self._schemas[-1])
        return number

    def channel(self, topic: str, schema: int, metadata: Mapping[str, str], *, encoding: str = "protobuf") -> int:
        """Declare a channel of a declared schema; returns its number. DamagedRecording where no reader takes it."""
        number = len(self._channels) + 1
        content = struct.pack("<HH", number, schema) + _text(topic) + _text(encoding) + _text_map(metadata)
        self._declared.parse(Record(Op.CHANNEL, self._offset, memoryview(content)))
        self._channels.append(_record(Op.CHANNEL, content))
        self._append(self._channels[-1])
        return number

    def message(
        self, channel: int, data: Buffer | Sequence[Part], *, log_time: int, publish_time: int, sequence: int
    ) -> None:
        """Add a message: its bytes, or the parts that they consist of, which must not change before `flush`.

        log_time, publish_time  [ns]
        """
        parts = [Part(data)] if isinstance(data, (bytes, bytearray, memoryview)) else data
        size = sum(len(part.data) for part in parts)
        head = _MESSAGE_HEAD.pack(Op.MESSAGE, 22 + size, channel, sequence, log_time, publish_time)
        message = _Message(channel, log_time, head, parts, len(head) + size)
        self._counts[channel] = self._counts.get(channel, 0) + 1
        self._first_time = log_time if self._first_time is None else min(self._first_time, log_time)
        self._last_time = max(self._last_time, log_time)
        if message.size >= _CHUNK_BYTES:
            self._end_chunk()
            self._write_chunk([message], later=parts is data)
            return
        self._waiting.append(message)
        self._waiting_bytes += message.size
        if self._waiting_bytes >= _CHUNK_BYTES:
            self.flush()

    def flush(self) -> None:
        """Write the open chunk and what is held back, so that a crash loses nothing that was added."""
        self._end_chunk()
        self._hand_over()

    def _end_chunk(self) -> None:
        if self._waiting:
            waiting, self._waiting, self._waiting_bytes = self._waiting, [], 0
            self._write_chunk(waiting, later=True)

    def attachment(self, name: str, media_type: str, data: bytes, *, log_time: int, create_time: int) -> None:
        """Add an attachment; times in ns."""
        self.flush()
        head = struct.pack("<QQ", log_time, create_time) + _text(name) + _text(media_type)
        record = _attachment(head, data)
        self._attachments[name] = _Place(self._offset, head, len(data), zlib.crc32(record))
        place = struct.pack("<QQQQQ", self._offset, len(record), log_time, create_time, len(data))
        self._attachment_indexes.append(_record(Op.ATTACHMENT_INDEX, place + _text(name) + _text(media_type)))
        self._append(record)

    def rewrite_attachment(self, name: str, data: bytes) -> None:
        """Put data of the same size in place of those of an attachment; what follows it stays as it is.

        ValueError where the size differs.
        """
        place = self._attachments[name]
        if len(data) != place.size:
            raise ValueError(f"{name} has {place.size} bytes, not {len(data)}")
        record = _attachment(place.head, data)
        crc, written = zlib.crc32(record), 0
        while written < len(record):
            written += os.pwrite(self._descriptor, record[written:], place.offset + written)
        # a CRC is linear: the difference of the two records, moved by the bytes that follow them
        self._crc = combine(place.crc ^ crc, self._crc, self._offset - place.offset - len(record))
        self._attachments[name] = place._replace(crc=crc)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self.flush()
        record = _record(Op.METADATA, _text(name) + _text_map(values))
        place = struct.pack("<QQ", self._offset, len(record))
        self._metadata_indexes.append(_record(Op.METADATA_INDEX, place + _text(name)))
        self._append(record)

    def finish(self) -> None:
        """End the data section; write the summary and the footer."""
        self.flush()
        self._write([Part(_record(Op.DATA_END, _U32.pack(self._crc)))])
        begin = self._offset
        groups = {
            Op.SCHEMA: self._schemas,
            Op.CHANNEL: self._channels,
            Op.STATISTICS: [self._statistics()],
            Op.CHUNK_INDEX: self._chunk_indexes,
            Op.ATTACHMENT_INDEX: self._attachment_indexes,
            Op.METADATA_INDEX: self._metadata_indexes,
        }
        summary, offsets = bytearray(), bytearray()
        for opcode, records in groups.items():
            group = b"".join(records)
            if group:
                offsets += _record(Op.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, begin + len(summary), len(group)))
                summary += group
        head = struct.pack("<BQQQ", Op.FOOTER, 20, begin, begin + len(summary))
        crc = zlib.crc32(summary + offsets + head)
        self._write([Part(summary), Part(offsets), Part(head + _U32.pack(crc) + MAGIC)])

    def _statistics(self) -> bytes:
        counts = b"".join(struct.pack("<HQ", number, count) for number, count in self._counts.items())
        content = struct.pack(
            "<QHIIIIQQ",
            sum(self._counts.values()),
            len(self._schemas),
            len(self._channels),
            len(self._attachment_indexes),
            len(self._metadata_indexes),
            len(self._chunk_indexes),
            self._first_time or 0,
            self._last_time,
        )
        return _record(Op.STATISTICS, content + _U32.pack(len(counts)) + counts)

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
        fixed = struct.pack("<QQQI", first, last, size, crc) + _text(self._compression) + _U64.pack(stored_size)
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
            + _text(self._compression)
            + struct.pack("<QQ", stored_size, size)
        )
        self._chunk_indexes.append(_record(Op.CHUNK_INDEX, content))

    def _message_indexes(self, messages: Sequence[_Message]) -> dict[int, bytes]:
        # a record for each channel of a chunk: when its messages are of, and where in the chunk they are
        entries: dict[int, list[bytes]] = {}
        position = 0
        for message in messages:
            entries.setdefault(message.channel, []).append(INDEX_ENTRY.pack(message.log_time, position))
            position += message.size
        return {
            channel: _record(Op.MESSAGE_INDEX, struct.pack("<HI", channel, 16 * len(found)) + b"".join(found))
            for channel, found in entries.items()
        }

    def _append(self, record: bytes) -> None:
        # a record of the data section that is no chunk
        self._crc = zlib.crc32(record, self._crc)
        self._write([Part(record)])

    def _write(self, parts: Sequence[Part], *, later: bool = False) -> None:
        pieces = [memoryview(part.data) for part in parts if len(part.data)]
        size = sum(map(len, pieces))
        self._queue += pieces
        self._queued += size
        self._offset += size
        if not later or self._queued >= _TOGETHER_BYTES or len(self._queue) >= _TOGETHER_PIECES:
            self._hand_over()

    def _hand_over(self) -> None:
        left, self._queue = self._queue, []
        begin, self._queued = self._offset - self._queued, 0
        try:
            while left:
                written = os.writev(self._descriptor, left[:_MOST_PIECES])
                while left and written >= len(left[0]):
                    written -= len(left.pop(0))
                if written:  # the disk took a part of one: the rest follows, or an error says why not
                    left[0] = left[0][written:]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, begin)  # a file that ends with a whole record is read by all
            raise


def _following(crc: int, part: Part) -> int:
    if part.crc is None:
        return zlib.crc32(part.data, crc)
    return combine(crc, part.crc, len(part.data))
