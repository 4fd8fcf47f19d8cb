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
from collections.abc import Mapping, Sequence
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import NamedTuple

from gpusimbench.schemas.mcap.assembly import (
    CHUNK_BYTES,
    COMPRESSIONS,
    Assembler,
    Buffer,
    Part,
    Records,
    record_of,
    text_of,
)
from gpusimbench.schemas.mcap.crc import combine
from gpusimbench.schemas.mcap.declarations import NewDeclarations
from gpusimbench.schemas.mcap.records import MAGIC, Op, Record

__all__ = ["COMPRESSIONS", "Buffer", "McapWriter", "Part"]

_MOST_PIECES = 1024  # that the operating system takes in one call (IOV_MAX of Linux and macOS)

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")


class _Place(NamedTuple):
    offset: int
    head: bytes  # of the content, before the size of the data
    size: int  # of the data
    crc: int  # of the whole record


def _text_map(values: Mapping[str, str]) -> bytes:
    data = b"".join(text_of(key) + text_of(value) for key, value in values.items())
    return _U32.pack(len(data)) + data


def _attachment(head: bytes, data: bytes) -> tuple[bytes, bytes, bytes]:
    # the pieces of a record: data may be large, and are not copied
    head += _U64.pack(len(data))
    crc = _U32.pack(zlib.crc32(data, zlib.crc32(head)))
    return struct.pack("<BQ", Op.ATTACHMENT, len(head) + len(data) + len(crc)) + head, data, crc


def _crc_of(pieces: Sequence[bytes], crc: int = 0) -> int:
    for piece in pieces:
        crc = zlib.crc32(piece, crc)
    return crc


class McapWriter(Assembler):
    """Writes one file, from its first byte to its footer.

    stream       open for writing, empty, without a buffer of its own; whoever opened it closes it
    profile      of the MCAP header
    library      of the MCAP header
    compression  a key of COMPRESSIONS

    OSError where the disk takes no more; the writer is of no use after that.
    """

    def __init__(self, stream: FileIO, *, profile: str, library: str, compression: str = "none") -> None:
        super().__init__(0, compression)
        self._descriptor = stream.fileno()
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._declared = NewDeclarations(Path("the file"))  # as a reader takes them
        self._attachment_indexes: list[bytes] = []
        self._attachments: dict[str, _Place] = {}
        self._metadata_indexes: list[bytes] = []
        self._append(MAGIC + record_of(Op.HEADER, text_of(profile) + text_of(library)))

    def schema(self, name: str, encoding: str, data: bytes) -> int:
        """Declare a schema; returns its number."""
        number = len(self._schemas) + 1
        content = _U16.pack(number) + text_of(name) + text_of(encoding) + _U32.pack(len(data)) + data
        self._schemas.append(record_of(Op.SCHEMA, content))
        self._append(self._schemas[-1])
        return number

    def channel(self, topic: str, schema: int, metadata: Mapping[str, str], *, encoding: str = "protobuf") -> int:
        """Declare a channel of a declared schema; returns its number. DamagedRecording where no reader takes it."""
        number = len(self._channels) + 1
        content = struct.pack("<HH", number, schema) + text_of(topic) + text_of(encoding) + _text_map(metadata)
        self._declared.parse(Record(Op.CHANNEL, self._offset, memoryview(content)))
        self._channels.append(record_of(Op.CHANNEL, content))
        self._append(self._channels[-1])
        return number

    @property
    def offset(self) -> int:
        """Where the next record begins."""
        return self._offset

    def make_room(self, size: int) -> bool:
        """Whether records may be appended in place of messages, the first of which has at least so many bytes.

        Not while small messages wait, with which it may share a chunk.
        """
        if size >= CHUNK_BYTES:
            self._end_chunk()
        return not self._waiting

    def append(self, records: Records) -> None:
        """Add messages whose records begin at `offset`; see Assembly."""
        if records.begin != self._offset or self._waiting:
            raise ValueError(f"records are made for offset {records.begin}, not {self._offset}")
        for channel, count in records.counts.items():
            self._counts[channel] = self._counts.get(channel, 0) + count
        if records.times:
            first, last = self._times or records.times
            self._times = min(first, records.times[0]), max(last, records.times[1])
        self._chunk_indexes += records.indexes
        self._crc = combine(self._crc, records.crc, records.size)
        self._queue += map(memoryview, records.pieces)
        self._queued += records.size
        self._offset += records.size
        self._hand_over()

    def attachment(self, name: str, media_type: str, data: bytes, *, log_time: int, create_time: int) -> None:
        """Add an attachment; times in ns."""
        self.flush()
        head = struct.pack("<QQ", log_time, create_time) + text_of(name) + text_of(media_type)
        pieces = _attachment(head, data)
        self._attachments[name] = _Place(self._offset, head, len(data), _crc_of(pieces))
        place = struct.pack("<QQQQQ", self._offset, sum(map(len, pieces)), log_time, create_time, len(data))
        self._attachment_indexes.append(record_of(Op.ATTACHMENT_INDEX, place + text_of(name) + text_of(media_type)))
        self._append(*pieces)

    def rewrite_attachment(self, name: str, data: bytes) -> None:
        """Put data of the same size in place of those of an attachment; what follows it stays as it is.

        ValueError where the size differs.
        """
        place = self._attachments[name]
        if len(data) != place.size:
            raise ValueError(f"{name} has {place.size} bytes, not {len(data)}")
        record = b"".join(_attachment(place.head, data))
        crc, written = zlib.crc32(record), 0
        while written < len(record):
            written += os.pwrite(self._descriptor, record[written:], place.offset + written)
        # a CRC is linear: the difference of the two records, moved by the bytes that follow them
        self._crc = combine(place.crc ^ crc, self._crc, self._offset - place.offset - len(record))
        self._attachments[name] = place._replace(crc=crc)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self.flush()
        record = record_of(Op.METADATA, text_of(name) + _text_map(values))
        place = struct.pack("<QQ", self._offset, len(record))
        self._metadata_indexes.append(record_of(Op.METADATA_INDEX, place + text_of(name)))
        self._append(record)

    def finish(self) -> None:
        """End the data section; write the summary and the footer."""
        self.flush()
        self._write([Part(record_of(Op.DATA_END, _U32.pack(self._crc)))])
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
                offsets += record_of(Op.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, begin + len(summary), len(group)))
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
            *(self._times or (0, 0)),
        )
        return record_of(Op.STATISTICS, content + _U32.pack(len(counts)) + counts)

    def _append(self, *pieces: bytes) -> None:
        # a record of the data section that is no chunk
        self._crc = _crc_of(pieces, self._crc)
        self._write(list(map(Part, pieces)))

    def _hand_over(self) -> None:
        left, self._queue = self._queue, []
        begin, self._queued = self._offset - self._queued, 0
        try:
            while left:
                written, count = os.writev(self._descriptor, left[:_MOST_PIECES]), 0
                while count < len(left) and written >= len(left[count]):
                    written -= len(left[count])
                    count += 1
                del left[:count]
                if written:  # the disk took a part of one: the rest follows, or an error says why not
                    left[0] = left[0][written:]
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._descriptor, begin)  # a file that ends with a whole record is read by all
            raise
