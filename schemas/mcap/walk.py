"""One walk over the records of an MCAP file, those of its chunks in their place: of readers, of copies, of gsb-check.

A plain walk raises DamagedRecording where what follows could not be trusted, and passes over what no number depends on.
A strict walk raises nothing for what a file holds: it reports each problem, with its place, and goes on behind it.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from struct import Struct
from typing import Literal, NamedTuple

from gpusimbench.schemas.errors import FailedCrc
from gpusimbench.schemas.mcap.decompression import decompress
from gpusimbench.schemas.mcap.records import (
    MAGIC,
    MESSAGE_HEAD,
    PRIVATE,
    RECORD_HEAD,
    WHOLE_MESSAGE_HEAD,
    Attachment,
    ChunkHead,
    Op,
    Record,
    damaged,
)
from gpusimbench.schemas.source import Source

Fault = Literal["record", "unknown_record", "chunk_crc", "attachment_crc", "data_crc", "crc_missing"]
"""Kinds of problems that a walk meets."""

Report = Callable[[Fault, str], None]

OF_DATA = (Op.MESSAGE, Op.CHUNK, Op.MESSAGE_INDEX, Op.ATTACHMENT, Op.METADATA, Op.DATA_END)
"""Records that stand in the data section alone."""

_IN_CHUNK = (Op.SCHEMA, Op.CHANNEL, Op.MESSAGE)
_IN_DATA = (Op.HEADER, Op.SCHEMA, Op.CHANNEL, *OF_DATA)
_HEAD = Struct("<BQ")  # of a record: opcode, and bytes that follow
_PIECE_BYTES = 4 << 20  # that a CRC is computed of at once


class Head(NamedTuple):
    """A whole record outside of chunks: its type, and the bytes of the file from which and up to which it goes."""

    opcode: int
    begin: int
    end: int


MessageHead = tuple[int, int, int, int]
"""Of a message in a chunk: channel, begin and end of its record, log time [ns]."""


def split(data: memoryview, messages: list[MessageHead] | None = None) -> Iterator[Record]:
    """Records one after another, up to the last whole one.

    messages  is told those that are messages, and they are not given; None where they are
    """
    position, size = 0, len(data)
    whole = size - WHOLE_MESSAGE_HEAD.size
    head_of, message_of, message = _HEAD.unpack_from, WHOLE_MESSAGE_HEAD.unpack_from, Op.MESSAGE
    while (begin := position + RECORD_HEAD) <= size:
        if messages is not None and position <= whole:
            opcode, length, channel, _, log_time, _ = message_of(data, position)
            if opcode == message and length >= MESSAGE_HEAD.size and (end := begin + length) <= size:
                messages.append((channel, position, end, log_time))
                position = end
                continue
        opcode, length = head_of(data, position)
        if (end := begin + length) > size:
            return
        yield Record(opcode, position, data[begin:end])
        position = end


def data_crc(source: Source, begin: int, end: int, crc: int = 0) -> int:
    """CRC-32 of a part of a file, and of what came before it."""
    for at in range(begin, end, _PIECE_BYTES):
        crc = zlib.crc32(source.read(at, min(end, at + _PIECE_BYTES)), crc)
    return crc


class Walk:
    """The records of a file in their order.

    source  of its bytes
    report  is told each problem, which makes the walk a strict one; None for a plain one

    end       of the last record that was visited
    in_data   whether the data section has not ended yet
    """

    def __init__(self, source: Source, report: Report | None = None) -> None:
        self._source = source
        self._report = report
        self._place = source.place
        self.end = len(MAGIC)
        self.in_data = True

    def __iter__(self) -> Iterator[Record]:
        """Each whole record outside of chunks, as of `heads`."""
        for head in self.heads():
            yield Record(head.opcode, head.begin, self._source.read(head.begin + RECORD_HEAD, head.end))

    def heads(self) -> Iterator[Head]:
        """Where each whole record outside of chunks is, up to the footer; nothing else of it is read.

        A strict walk passes over those that MCAP has no type for.
        """
        while self.end + RECORD_HEAD <= self._source.size:
            begin = self.end
            opcode, length = _HEAD.unpack(self._source.read(begin, begin + RECORD_HEAD))
            head = Head(opcode, begin, begin + RECORD_HEAD + length)
            if head.end > self._source.size or (head.opcode == 0 and self._report is None):
                return  # zeros are no record: a crash leaves them where bytes never arrived
            self.end = head.end
            if self._in_place(head):
                yield head
            if head.opcode in (Op.DATA_END, Op.FOOTER):
                self.in_data = False
            if head.opcode == Op.FOOTER:
                return

    def _in_place(self, head: Head) -> bool:
        # whether there is something to be read of it, where it stands
        opcode, first = head.opcode, head.begin == len(MAGIC)
        if self._report is None:
            if first != (opcode == Op.HEADER):
                raise damaged(self._place, "the file does not begin with a header, or has a second one")
            if not self.in_data and opcode in OF_DATA:
                raise damaged(self._place, "data follow behind the end of the data")
            return True
        if first and opcode != Op.HEADER:
            self._report("record", "the first record is no header")
        if not 0 < opcode <= Op.DATA_END:
            self._unknown(opcode, head.end - head.begin - RECORD_HEAD, f"byte {head.begin}")
            return False
        if self.in_data and opcode == Op.HEADER and not first:
            self._report("record", f"there is a second header at byte {head.begin}")
            return False
        if self.in_data and opcode not in _IN_DATA:
            self._report("record", f"a record of the summary, type {opcode}, lies before the data section's end")
            return False
        return True

    def _unknown(self, opcode: int, size: int, where: str) -> None:
        if self._report is not None and opcode < PRIVATE:
            self._report("unknown_record", f"a record of type {opcode:#04x} at {where}, {size} bytes")

    def head(self, record: Record) -> ChunkHead:
        """What a chunk says of itself. DamagedRecording, also of a strict walk, where that cannot be."""
        cursor = record.cursor(self._place)
        head = ChunkHead.read(cursor)
        cursor.take(head.chunk.end - head.chunk.begin)
        if cursor.left and self._report is not None:
            raise damaged(self._place, f"the chunk at byte {record.begin} is longer than its fields state")
        return head

    def inside(self, record: Record, head: ChunkHead) -> Iterator[Record]:
        """The records of a chunk, as of `within`; none where a strict walk finds it lost."""
        data = self.open(record, head)
        return iter(()) if data is None else self.within(data, record.begin)

    def open(
        self, record: Record, head: ChunkHead, held: Callable[[memoryview], str] = lambda data: ""
    ) -> memoryview | None:
        """The bytes of a chunk, decompressed; None where a strict walk finds it lost.

        held  says of the bytes of a chunk that fails its CRC what they are of, for the report
        """
        chunk = head.chunk
        stored = record.content[chunk.begin - chunk.record : chunk.end - chunk.record]
        try:
            data = decompress(chunk.compression, stored, chunk.uncompressed_size)
        except ValueError as error:
            self._wrong("chunk_crc", f"the chunk at byte {record.begin} is lost: {error}")
            return None
        if not head.crc:
            self._skip("crc_missing", "chunks have no CRC")
        elif zlib.crc32(data) != head.crc:
            what = f"the chunk at byte {record.begin}, {len(stored)} bytes, fails its CRC"
            self._wrong("chunk_crc", what if self._report is None else f"{what}; it is of {held(data)}")
        return data

    def within(self, data: memoryview, at: int, messages: list[MessageHead] | None = None) -> Iterator[Record]:
        """What declares and what tells something among the records of the chunk at byte `at`, from its bytes.

        messages  as of `split`
        """
        inner = None
        for inner in split(data, messages):
            opcode = inner.opcode
            if opcode in _IN_CHUNK:
                yield inner
            elif not 0 < opcode <= Op.DATA_END:
                self._unknown(opcode, len(inner.content), f"byte {inner.begin} of the chunk at byte {at}")
            else:
                self._skip("record", f"the chunk at byte {at} holds a record of type {opcode}")
        ends = (0 if inner is None else inner.end, messages[-1][2] if messages else 0)
        if max(ends) != len(data):
            self._wrong("record", f"the chunk at byte {at} ends within a record")

    def attachment(self, record: Record) -> Attachment:
        """What an attachment says of itself. DamagedRecording, also of a strict walk, where that cannot be."""
        cursor = record.cursor(self._place)
        found = Attachment.read(cursor)
        if found.end - found.begin + 4 > cursor.left or (self._report and found.end - found.begin + 4 != cursor.left):
            raise damaged(self._place, f"the attachment {found.name} has a length other than its fields state")
        return found

    def attached(self, record: Record, found: Attachment) -> tuple[memoryview, bool]:
        """The bytes of an attachment, and whether they are those that its CRC is of."""
        begin, end = found.begin - found.record, found.end - found.record
        crc = int.from_bytes(record.content[end : end + 4], "little")
        good = not crc or zlib.crc32(record.content[:end]) == crc
        if not crc:
            self._skip("crc_missing", f"the attachment {found.name} has no CRC")
        elif not good:
            self._wrong("attachment_crc", f"the attachment {found.name} fails its CRC")
        return record.content[begin:end], good

    def data_end(self, record: Record) -> int:
        """The CRC of the data section, zero where it has none; a strict walk computes it."""
        crc = record.cursor(self._place).u32()
        if not crc:
            self._skip("crc_missing", "the data section has no CRC")
        elif self._report is not None and data_crc(self._source, 0, record.begin) != crc:
            self._report("data_crc", "bytes between the file's beginning and the data section's end were changed")
        return crc

    def _wrong(self, fault: Fault, what: str) -> None:
        if self._report is None:
            raise FailedCrc(f"{self._place}: {what}") if fault.endswith("_crc") else damaged(self._place, what)
        self._report(fault, what)

    def _skip(self, fault: Fault, what: str) -> None:
        if self._report is not None:
            self._report(fault, what)
