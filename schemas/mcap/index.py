"""What the summary section of an MCAP file says is where, so that a file elsewhere is opened with a few requests.

A summary is a claim like any other. Here its own records are held against its CRC, the size of the file, and each
other; what is found at a place is held against it when it is read (schemas.mcap.reader).
"""

from __future__ import annotations

import struct
import zlib
from array import array
from bisect import bisect_left
from dataclasses import dataclass

from gpusimbench.schemas.errors import DamagedRecording, FailedCrc
from gpusimbench.schemas.mcap import decompression
from gpusimbench.schemas.mcap.declarations import Declarations
from gpusimbench.schemas.mcap.records import (
    INDEX_ENTRY,
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Attachment,
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    Op,
    Record,
    Statistics,
    damaged,
    parse,
)
from gpusimbench.schemas.mcap.walk import split
from gpusimbench.schemas.source import Source

MAX_SUMMARY_BYTES = 64 << 20
"""A larger summary is not read."""

_FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_INDEX_HEAD = RECORD_HEAD + 6  # of a message index, before its entries
_CHUNK_HEAD = 40  # of a chunk, without the name of its compression
_NOT_HERE = (0, Op.HEADER, Op.FOOTER, Op.MESSAGE, Op.CHUNK, Op.MESSAGE_INDEX, Op.ATTACHMENT, Op.METADATA, Op.DATA_END)


@dataclass(frozen=True, slots=True)
class IndexedChunk:
    """A chunk as the summary has it.

    first_time, last_time  log times of its messages [ns]
    channels               that have messages in it, in order of their numbers
    places                 where the record is that lists the messages of each; all behind the chunk, in one piece
    index_bytes            of all of them
    """

    chunk: Chunk
    first_time: int
    last_time: int
    channels: array[int]
    places: array[int]
    index_bytes: int

    def place_of(self, channel: int) -> int:
        """Where the messages of one of the channels are listed."""
        return self.places[bisect_left(self.channels, channel)]

    @property
    def messages(self) -> int:
        """How many the lengths of the indexes leave room for."""
        return max(0, self.index_bytes - _INDEX_HEAD * len(self.channels)) // INDEX_ENTRY.size


@dataclass(frozen=True, slots=True)
class Index:
    """The summary of a file.

    data_end, data_crc  where the record is that ends the data section; the CRC in it, zero where there is none
    declared            schemas and channels
    chunks              in the order of the file
    attachments         the same
    """

    data_end: int
    data_crc: int
    declared: Declarations
    chunks: tuple[IndexedChunk, ...]
    attachments: tuple[Attachment, ...]


def read_index(source: Source) -> Index | None:
    """The index of a finished file; None where it has none that tells all of it.

    DamagedRecording where it contradicts itself or the file.
    """
    footer_at = source.size - len(MAGIC) - _FOOTER.size
    if footer_at < len(MAGIC) + _DATA_END.size:
        return None
    tail = source.read(footer_at, source.size)
    opcode, length, begin, offsets, crc = _FOOTER.unpack_from(tail)
    if tail[-len(MAGIC) :] != MAGIC or (opcode, length) != (Op.FOOTER, _FOOTER.size - RECORD_HEAD) or not begin:
        return None
    data_end = begin - _DATA_END.size
    if not len(MAGIC) <= data_end <= footer_at or not (offsets == 0 or begin <= offsets <= footer_at):
        raise DamagedRecording(f"{source.place}: the footer points to no summary")
    if footer_at - begin > MAX_SUMMARY_BYTES:
        raise DamagedRecording(
            f"{source.place}: its summary has {footer_at - begin} bytes, more than are read from elsewhere; download it"
        )
    section = source.read(data_end, source.size)
    if crc and zlib.crc32(section[_DATA_END.size : -len(MAGIC) - 4]) != crc:
        raise FailedCrc(f"{source.place}: the summary fails its CRC")
    opcode, length, data_crc = _DATA_END.unpack_from(section)
    if (opcode, length) != (Op.DATA_END, _DATA_END.size - RECORD_HEAD):
        return None
    return _Summary(source, data_end).read(section[_DATA_END.size : footer_at - data_end], data_crc)


class _Summary:
    def __init__(self, source: Source, data_end: int) -> None:
        self._place = source.place
        self._data_end = data_end
        self._declared = Declarations(source.place)
        self._channels = 0  # records of them
        self._chunks: list[IndexedChunk] = []
        self._attachments: list[Attachment] = []
        self._counts: tuple[int, int, int, int] | None = None  # messages, channels, attachments, chunks

    def read(self, section: memoryview, data_crc: int) -> Index | None:
        begin = end = self._data_end + _DATA_END.size
        for found in split(section):
            record = found._replace(begin=begin + found.begin)
            self._take(record)
            end = record.end
        if end != begin + len(section):
            raise damaged(self._place, f"a record at byte {end} is shorter than it says")
        self._chunks.sort(key=lambda c: c.chunk.record)
        self._check_places()
        if self._counts != self._counted() or not self._declared.whole:
            return None
        return Index(self._data_end, data_crc, self._declared, tuple(self._chunks), tuple(self._attachments))

    def _take(self, record: Record) -> None:
        opcode, cursor = record.opcode, record.cursor(self._place)
        if opcode in _NOT_HERE:
            raise damaged(self._place, f"its summary has a record of type {opcode}, which no summary may have")
        if opcode in (Op.SCHEMA, Op.CHANNEL):
            self._declared.take(record)
            self._channels += opcode == Op.CHANNEL
        elif opcode == Op.CHUNK_INDEX:
            self._chunks.append(self._chunk(parse(ChunkIndex, cursor)))
        elif opcode == Op.ATTACHMENT_INDEX:
            self._attachments.append(self._attachment(parse(AttachmentIndex, cursor)))
        elif opcode == Op.STATISTICS:
            said = parse(Statistics, cursor)
            self._counts = said.messages, said.channels, said.attachments, said.chunks

    def _counted(self) -> tuple[int, int, int, int]:
        # Messages outside of chunks are in no index, so the numbers have to agree; where chunks have no index of their
        # messages, these are counted by nobody.
        indexed = all(c.channels or not c.chunk.uncompressed_size for c in self._chunks)
        messages = sum(c.messages for c in self._chunks) if indexed or self._counts is None else self._counts[0]
        return messages, self._channels, len(self._attachments), len(self._chunks)

    def _chunk(self, said: ChunkIndex) -> IndexedChunk:
        listed = sorted(said.places.items())
        channels, places = array("H", [c for c, _ in listed]), array("Q", [at for _, at in listed])
        content, end = said.start + RECORD_HEAD, said.start + said.length
        if said.length != RECORD_HEAD + _CHUNK_HEAD + len(said.compression.encode()) + said.stored:
            raise damaged(self._place, f"the index entry of the chunk at byte {said.start} has contradictory lengths")
        if said.uncompressed_size > decompression.limit(said.compression, said.stored):
            what = f"the chunk at byte {said.start} cannot decompress to the size in its index entry"
            raise damaged(self._place, what)
        chunk = Chunk(said.compression, said.uncompressed_size, content, end - said.stored, end)
        found = IndexedChunk(chunk, said.first_time, said.last_time, channels, places, said.index_bytes)
        # each index takes a few bytes, and each message that is listed: what can be announced is less than the file
        behind, wrong = end, f"the index entry of the chunk at byte {said.start} lists impossible messages"
        for at in sorted(places):
            if not behind <= at <= end + said.index_bytes - _INDEX_HEAD:
                raise damaged(self._place, wrong)
            behind = at + _INDEX_HEAD
        if found.messages > said.uncompressed_size // (RECORD_HEAD + MESSAGE_HEAD.size):
            raise damaged(self._place, wrong)
        return found

    def _attachment(self, said: AttachmentIndex) -> Attachment:
        content = said.start + RECORD_HEAD
        begin = content + 16 + 4 + len(said.name.encode()) + 4 + len(said.media_type.encode()) + 8
        if said.start + said.length != begin + said.data_size + 4:
            raise damaged(self._place, f"the index entry of the attachment {said.name} has contradictory lengths")
        end = begin + said.data_size
        return Attachment(said.name, said.media_type, content, begin, end, said.log_time, said.create_time)

    def _check_places(self) -> None:
        # within the data section, none upon another
        taken = [(c.chunk.at, c.chunk.end + c.index_bytes) for c in self._chunks]
        taken += [(a.record - RECORD_HEAD, a.end + 4) for a in self._attachments]
        behind = len(MAGIC)
        for begin, end in sorted(taken):
            if begin < behind or end > self._data_end:
                raise damaged(
                    self._place, f"the index places a record at byte {begin}, outside the data or in another record"
                )
            behind = end
