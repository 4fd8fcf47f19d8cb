"""The records of an MCAP file: what each type says, field by field. Running past the end of a record is damage."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import NamedTuple

from schemas.errors import DamagedRecording
from schemas.location import Place

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
"""Opcodes."""

PRIVATE = 0x80
"""Opcodes from here on belong to applications: readers pass over them."""

RECORD_HEAD = 9
"""Opcode and length of a record [byte]."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Of a message: channel, sequence, log time, publish time."""

INDEX_ENTRY = struct.Struct("<QQ")
"""Of a message index: log time, and offset of the message's record in its chunk."""

_PAIR = struct.Struct("<HQ")  # a channel, and a number
_MAX_NAME = 1024


class Cursor:
    """Reads the fields of a record, one after another.

    place     of the file, for messages of errors
    data      whatever holds the record
    position  in `data`, of the next field
    end       of the record in `data`
    base      byte of the file, or of its chunk, at which `data` begins
    """

    def __init__(self, place: Place, data: memoryview, position: int, end: int, base: int = 0) -> None:
        self.place = place
        self._data = data
        self.position = position
        self._end = end
        self._base = base

    def take(self, size: int) -> memoryview:
        """The next bytes."""
        if size > self._end - self.position:
            raise DamagedRecording(f"{self.place}: a record at byte {self.at} is shorter than it says")
        part = self._data[self.position : self.position + size]
        self.position += size
        return part

    @property
    def at(self) -> int:
        """Of the next field, in the file or chunk."""
        return self._base + self.position

    @property
    def left(self) -> int:
        """Bytes up to the end of the record."""
        return self._end - self.position

    def u16(self) -> int:
        """A number of 2 bytes; and so on."""
        return int.from_bytes(self.take(2), "little")

    def u32(self) -> int:
        """See u16."""
        return int.from_bytes(self.take(4), "little")

    def u64(self) -> int:
        """See u16."""
        return int.from_bytes(self.take(8), "little")

    def text(self) -> str:
        """A text, its length first."""
        try:
            return bytes(self.take(self.u32())).decode()
        except UnicodeDecodeError:
            raise DamagedRecording(f"{self.place}: a name at byte {self.at} is not UTF-8") from None

    def name(self) -> str:
        """A text that is not long."""
        text = self.text()
        if len(text) > _MAX_NAME:
            raise DamagedRecording(f"{self.place}: the name at byte {self.at} has {len(text)} characters")
        return text

    def rest(self) -> memoryview:
        """What is left of the record, which is not taken by this."""
        return self._data[self.position : self._end]

    def inner(self, size: int) -> Cursor:
        """The next bytes, as a record of their own."""
        begin = self.position
        self.take(size)
        return Cursor(self.place, self._data, begin, self.position, self._base)

    def pairs(self, size: int) -> list[tuple[int, int]]:
        """Numbers by channel, in so many bytes."""
        if size % _PAIR.size or size > _PAIR.size << 16:
            raise DamagedRecording(f"{self.place}: {size} bytes are no list of numbers by channel, at byte {self.at}")
        return list(_PAIR.iter_unpack(self.take(size)))

    def text_map(self) -> dict[str, str]:
        """Texts by their names."""
        found = self.inner(self.u32())
        values = dict[str, str]()
        while found.left:
            key = found.text()
            values[key] = found.text()
        return values


class Record(NamedTuple):
    """A whole record in place: its type, the byte of the file or chunk at which it begins, and its content."""

    opcode: int
    begin: int
    content: memoryview

    @property
    def end(self) -> int:
        """The byte behind it, in the file or chunk."""
        return self.begin + RECORD_HEAD + len(self.content)

    @property
    def length(self) -> int:
        """With opcode and length [byte]."""
        return RECORD_HEAD + len(self.content)

    def cursor(self, place: Place) -> Cursor:
        """Reads its content; errors name the place."""
        return Cursor(place, self.content, 0, len(self.content), self.begin + RECORD_HEAD)

    def message(self, place: Place) -> tuple[int, int, int, memoryview]:
        """Of a message: channel, sequence, log time [ns] and content."""
        if len(self.content) < MESSAGE_HEAD.size:
            raise DamagedRecording(f"{place}: a message at byte {self.begin} is shorter than its own head")
        channel, sequence, log_time, _ = MESSAGE_HEAD.unpack_from(self.content)
        return channel, sequence, log_time, self.content[MESSAGE_HEAD.size :]

    def message_index(self, place: Place) -> tuple[int, memoryview]:
        """Of a message index: channel, and its entries, each an INDEX_ENTRY."""
        cursor = self.cursor(place)
        channel = cursor.u16()
        entries = cursor.take(cursor.u32())
        if len(entries) % INDEX_ENTRY.size:
            raise DamagedRecording(f"{place}: the message index at byte {self.begin} has half an entry")
        return channel, entries


@dataclass(frozen=True, slots=True)
class Header:
    """What stands first in a file; `library` is the writer, by its own word."""

    profile: str
    library: str

    @classmethod
    def read(cls, cursor: Cursor) -> Header:
        """From a record; and so on for each type."""
        return cls(cursor.name(), cursor.name() if cursor.left else "")


@dataclass(frozen=True, slots=True)
class Schema:
    """The definition of a message type."""

    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def read(cls, cursor: Cursor) -> Schema:
        """See Header.read."""
        return cls(cursor.u16(), cursor.name(), cursor.text(), bytes(cursor.take(cursor.u32())))


@dataclass(frozen=True, slots=True)
class ChannelRecord:
    """A channel, by its numbers: `schema_id` is 0 where it has no schema."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]

    @classmethod
    def read(cls, cursor: Cursor) -> ChannelRecord:
        """See Header.read."""
        return cls(cursor.u16(), cursor.u16(), cursor.name(), cursor.text(), cursor.text_map())


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk of messages: its bytes, places in the file, and how many they become.

    record      where the record's content begins
    begin, end  of the stored bytes; the record ends with them
    """

    compression: str
    uncompressed_size: int
    record: int
    begin: int
    end: int


class ChunkHead(NamedTuple):
    """A chunk, what it says of the log times of its messages [ns], and its CRC, zero where it has none."""

    chunk: Chunk
    first_time: int
    last_time: int
    crc: int

    @classmethod
    def read(cls, cursor: Cursor) -> ChunkHead:
        """See Header.read; the chunk's bytes need not be there yet."""
        record, first, last = cursor.at, cursor.u64(), cursor.u64()
        uncompressed_size, crc, compression = cursor.u64(), cursor.u32(), cursor.name()
        stored = cursor.u64()
        return cls(Chunk(compression, uncompressed_size, record, cursor.at, cursor.at + stored), first, last, crc)


@dataclass(frozen=True, slots=True)
class Attachment:
    """An attachment.

    record      where the record's content begins
    begin, end  of its data; four bytes of CRC follow, and the record ends
    log_time, create_time  [ns]; two that differ in nothing else are the same attachment
    """

    name: str
    media_type: str
    record: int
    begin: int
    end: int
    log_time: int = field(compare=False)
    create_time: int = field(compare=False)

    @classmethod
    def read(cls, cursor: Cursor) -> Attachment:
        """See Header.read; the attachment's bytes need not be there yet."""
        record, log_time, create_time = cursor.at, cursor.u64(), cursor.u64()
        name, media_type, size = cursor.name(), cursor.name(), cursor.u64()
        return cls(name, media_type, record, cursor.at, cursor.at + size, log_time, create_time)


@dataclass(frozen=True, slots=True)
class Metadata:
    """Texts by name, for whoever knows them."""

    name: str
    metadata: dict[str, str]

    @classmethod
    def read(cls, cursor: Cursor) -> Metadata:
        """See Header.read."""
        return cls(cursor.text(), cursor.text_map())


@dataclass(frozen=True, slots=True)
class Footer:
    """Where the summary and its offsets begin, zero where there are none; the CRC of the bytes before it."""

    summary_start: int
    offsets_start: int
    summary_crc: int

    @classmethod
    def read(cls, cursor: Cursor) -> Footer:
        """See Header.read."""
        return cls(cursor.u64(), cursor.u64(), cursor.u32())


@dataclass(frozen=True, slots=True)
class ChunkIndex:
    """What the summary says of a chunk.

    start, length  of the chunk's record
    places         by channel, where the record is that lists its messages
    index_bytes    of all these records
    """

    first_time: int
    last_time: int
    start: int
    length: int
    places: dict[int, int]
    index_bytes: int
    compression: str
    stored: int
    uncompressed_size: int

    @classmethod
    def read(cls, cursor: Cursor) -> ChunkIndex:
        """See Header.read."""
        first, last, start, length = cursor.u64(), cursor.u64(), cursor.u64(), cursor.u64()
        listed = cursor.pairs(cursor.u32())
        places = dict(listed)
        if len(places) < len(listed):
            raise DamagedRecording(f"{cursor.place}: the index of the chunk at byte {start} lists a channel twice")
        return cls(first, last, start, length, places, cursor.u64(), cursor.name(), cursor.u64(), cursor.u64())


@dataclass(frozen=True, slots=True)
class AttachmentIndex:
    """What the summary says of an attachment; `start` and `length` are of its record."""

    start: int
    length: int
    log_time: int
    create_time: int
    data_size: int
    name: str
    media_type: str

    @classmethod
    def read(cls, cursor: Cursor) -> AttachmentIndex:
        """See Header.read."""
        start, length, log_time, create_time = cursor.u64(), cursor.u64(), cursor.u64(), cursor.u64()
        return cls(start, length, log_time, create_time, cursor.u64(), cursor.name(), cursor.name())


@dataclass(frozen=True, slots=True)
class MetadataIndex:
    """What the summary says of a metadata record; `start` and `length` are of that."""

    start: int
    length: int
    name: str

    @classmethod
    def read(cls, cursor: Cursor) -> MetadataIndex:
        """See Header.read."""
        return cls(cursor.u64(), cursor.u64(), cursor.text())


@dataclass(frozen=True, slots=True)
class Statistics:
    """What the summary counts; times are in ns, `by_channel` are messages."""

    messages: int
    schemas: int
    channels: int
    attachments: int
    metadata: int
    chunks: int
    first_time: int
    last_time: int
    by_channel: dict[int, int]

    @classmethod
    def read(cls, cursor: Cursor) -> Statistics:
        """See Header.read."""
        messages, schemas, channels, attachments = cursor.u64(), cursor.u16(), cursor.u32(), cursor.u32()
        metadata, chunks, first, last = cursor.u32(), cursor.u32(), cursor.u64(), cursor.u64()
        by_channel = dict(cursor.pairs(cursor.u32()))
        return cls(messages, schemas, channels, attachments, metadata, chunks, first, last, by_channel)


def check_head(place: Place, opcode: int, record: memoryview, length: int) -> None:
    """DamagedRecording where a record is not of that type and length [byte, without its head]."""
    if record[0] != opcode or int.from_bytes(record[1:RECORD_HEAD], "little") != length:
        raise DamagedRecording(f"{place}: the file's index points to a record of another type or length")
