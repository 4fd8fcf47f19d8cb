"""The records of an MCAP file: what each type says, field by field. Running past the end of a record is damage."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Place

MAGIC = b"\x89MCAP0\r\n"


class Op:
    """Opcodes."""

    HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
    ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)


PRIVATE = 0x80
"""Opcodes from here on belong to applications: readers pass over them."""

RECORD_HEAD = 9
"""Opcode and length of a record [byte]."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
WHOLE_MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # with what begins its record
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
        """The place of the next field, in the file or chunk."""
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

    def library(self) -> str:
        """A name that may be missing at the end of a record."""
        return self.name() if self.left else ""

    def data(self) -> bytes:
        """Bytes, their number first."""
        return bytes(self.take(self.u32()))

    def pairs(self) -> dict[int, int]:
        """Numbers by channel."""
        at, data = self.at, self.take(self.u32())
        if len(data) % _PAIR.size == 0 and len(data) <= _PAIR.size << 16:
            found = dict(_PAIR.iter_unpack(data))
            if len(found) * _PAIR.size == len(data):
                return found
        raise DamagedRecording(f"{self.place}: what is listed at byte {at} is not one number for each channel")

    def text_map(self) -> dict[str, str]:
        """Texts by their names."""
        end = self.u32() + self.position
        values = dict[str, str]()
        while self.position < end:
            key = self.text()
            values[key] = self.text()
        if self.position != end:
            raise DamagedRecording(f"{self.place}: a list of texts ends within one, at byte {self.at}")
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
        """The length of the record, with its opcode and its length field [byte]."""
        return RECORD_HEAD + len(self.content)

    def cursor(self, place: Place) -> Cursor:
        """Reads its content; errors name the place."""
        return Cursor(place, self.content, 0, len(self.content), self.begin + RECORD_HEAD)

    def message(self, place: Place) -> tuple[int, int, int, memoryview]:
        """The parts of a message: channel, sequence, log time [ns] and content."""
        if len(self.content) < MESSAGE_HEAD.size:
            raise DamagedRecording(f"{place}: a message at byte {self.begin} is shorter than its own head")
        channel, sequence, log_time, _ = MESSAGE_HEAD.unpack_from(self.content)
        return channel, sequence, log_time, self.content[MESSAGE_HEAD.size :]

    def message_index(self, place: Place) -> tuple[int, memoryview]:
        """The parts of a message index: channel, and its entries, each an INDEX_ENTRY."""
        cursor = self.cursor(place)
        channel = cursor.u16()
        entries = cursor.take(cursor.u32())
        if len(entries) % INDEX_ENTRY.size:
            raise DamagedRecording(f"{place}: the message index at byte {self.begin} has half an entry")
        return channel, entries


class Header(NamedTuple):
    """What stands first in a file; `library` is the writer, by its own word."""

    profile: str
    library: str


class Schema(NamedTuple):
    """The definition of a message type."""

    id: int
    name: str
    encoding: str
    data: bytes


class ChannelRecord(NamedTuple):
    """A channel, by its numbers: `schema_id` is 0 where it has no schema."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: dict[str, str]


class Metadata(NamedTuple):
    """Texts by name, for whoever knows them."""

    name: str
    metadata: dict[str, str]


class Footer(NamedTuple):
    """Where the summary and its offsets begin, zero where there are none; the CRC of the bytes before it."""

    summary_start: int
    offsets_start: int
    summary_crc: int


class ChunkIndex(NamedTuple):
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


class AttachmentIndex(NamedTuple):
    """What the summary says of an attachment; `start` and `length` are of its record."""

    start: int
    length: int
    log_time: int
    create_time: int
    data_size: int
    name: str
    media_type: str


class MetadataIndex(NamedTuple):
    """What the summary says of a metadata record; `start` and `length` are of that."""

    start: int
    length: int
    name: str


class Statistics(NamedTuple):
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


_Said = TypeVar("_Said", bound=tuple[Any, ...])

_FIELDS: dict[type[Any], str] = {
    Header: "name library",
    Schema: "u16 name text data",
    ChannelRecord: "u16 u16 name text text_map",
    Metadata: "text text_map",
    Footer: "u64 u64 u32",
    ChunkIndex: "u64 u64 u64 u64 pairs u64 name u64 u64",
    AttachmentIndex: "u64 u64 u64 u64 u64 name name",
    MetadataIndex: "u64 u64 text",
    Statistics: "u64 u16 u32 u32 u32 u32 u64 u64 pairs",
}
"""Methods of Cursor that read the fields of each type, in their order."""


def parse(kind: type[_Said], cursor: Cursor) -> _Said:
    """What a record of one of these types says; DamagedRecording where it cannot be read."""
    return kind(*[getattr(cursor, name)() for name in _FIELDS[kind].split()])


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

    @property
    def at(self) -> int:
        """The byte of the file at which the whole record begins: what messages name a chunk by."""
        return self.record - RECORD_HEAD


class ChunkHead(NamedTuple):
    """A chunk, what it says of the log times of its messages [ns], and its CRC, zero where it has none."""

    chunk: Chunk
    first_time: int
    last_time: int
    crc: int

    @classmethod
    def read(cls, cursor: Cursor) -> ChunkHead:
        """From a record's beginning; the chunk's bytes need not be there yet."""
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
        """From a record's beginning; the attachment's bytes need not be there yet."""
        record, log_time, create_time = cursor.at, cursor.u64(), cursor.u64()
        name, media_type, size = cursor.name(), cursor.name(), cursor.u64()
        return cls(name, media_type, record, cursor.at, cursor.at + size, log_time, create_time)


def damaged(place: Place, what: str) -> DamagedRecording:
    """The error of a file at a place, with what is wrong."""
    return DamagedRecording(f"{place}: {what}")


def check_head(place: Place, opcode: int, record: memoryview, length: int) -> None:
    """DamagedRecording where a record is not of that type and length [byte, without its head]."""
    if record[0] != opcode or int.from_bytes(record[1:RECORD_HEAD], "little") != length:
        raise DamagedRecording(f"{place}: the file's index points to a record of another type or length")
