"""MCAP files as lists of records, taken apart and put together by the tests' own few lines.

Written from the specification (https://mcap.dev/spec) and not from the project's reader: a mistake that both shared
would be seen by neither.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = range(1, 8)
ATTACHMENT, METADATA, DATA_END = 9, 12, 15
HEAD = 9
"""Bytes before a record's body: opcode and length."""

_IN_CHUNKS = (SCHEMA, CHANNEL, MESSAGE)
_MESSAGE = struct.Struct("<HIQQ")


@dataclass(frozen=True)
class Record:
    """A record as it is: opcode and body."""

    opcode: int
    body: bytes

    def bytes(self) -> bytes:
        """With opcode and length."""
        return struct.pack("<BQ", self.opcode, len(self.body)) + self.body


@dataclass(frozen=True)
class Message:
    """A message's fields."""

    channel: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes

    @classmethod
    def of(cls, record: Record) -> Message:
        """From its record."""
        return cls(*_MESSAGE.unpack_from(record.body), record.body[_MESSAGE.size :])

    def record(self) -> Record:
        """As a record."""
        head = _MESSAGE.pack(self.channel, self.sequence, self.log_time, self.publish_time)
        return Record(MESSAGE, head + self.data)


@dataclass(frozen=True)
class Chunk:
    """A chunk's records and how they are compressed: "", "lz4" or "zstd"."""

    compression: str
    records: tuple[Record, ...]


@dataclass(frozen=True)
class Attachment:
    """An attachment without its CRC."""

    name: str
    media_type: str
    data: bytes
    log_time: int = 0
    create_time: int = 0


Item = Record | Chunk | Attachment


@dataclass(frozen=True)
class File:
    """What a file says, without what only helps to find it: indexes, summary, CRCs.

    items     of the data section, in order
    finished  has its footer
    """

    items: tuple[Item, ...]
    finished: bool = True

    def channels(self) -> dict[int, str]:
        """Topics by channel."""
        records = (r for r in self.records() if r.opcode == CHANNEL)
        return {struct.unpack_from("<H", r.body)[0]: _text(r.body, 4)[0] for r in records}

    def records(self) -> Iterator[Record]:
        """Schemas, channels, messages, and whatever else chunks hold."""
        for item in self.items:
            if isinstance(item, Chunk):
                yield from item.records
            elif isinstance(item, Record) and item.opcode in _IN_CHUNKS:
                yield item

    def with_records(self, records: Iterable[Record], *, compression: str = "", per_chunk: int = 8) -> File:
        """The same attachments and metadata, and other messages, schemas and channels, in new chunks."""
        kept = [i for i in self.items if not isinstance(i, Chunk)]
        kept = [i for i in kept if not (isinstance(i, Record) and i.opcode in _IN_CHUNKS)]
        new = list(records)
        chunks = [Chunk(compression, tuple(new[i : i + per_chunk])) for i in range(0, len(new), per_chunk)]
        return replace(self, items=(*kept, *chunks))


def _text(body: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", body, at)
    return body[at + 4 : at + 4 + size].decode(), at + 4 + size


def pack_text(text: str | bytes) -> bytes:
    """A string with its length."""
    raw = text.encode() if isinstance(text, str) else text
    return struct.pack("<I", len(raw)) + raw


def pack_channel(number: int, schema: int, topic: str, metadata: dict[str, str] | None = None) -> Record:
    """A channel's record."""
    values = b"".join(pack_text(k) + pack_text(v) for k, v in (metadata or {}).items())
    body = struct.pack("<HH", number, schema) + pack_text(topic) + pack_text("protobuf") + pack_text(values)
    return Record(CHANNEL, body)


def pack_chunk(compression: str, records: bytes, stored: bytes, *, size: int | None = None) -> Record:
    """A chunk's record.

    records  what its CRC is of
    stored   what it holds
    size     that it announces; what `records` have where None
    """
    announced = len(records) if size is None else size
    head = struct.pack("<QQQI", 0, 0, announced, zlib.crc32(records))
    return Record(CHUNK, head + pack_text(compression) + struct.pack("<Q", len(stored)) + stored)


def compress(compression: str, data: bytes) -> bytes:
    """Data as a chunk holds it."""
    if compression == "zstd":
        return zstandard.ZstdCompressor(level=1).compress(data)
    return lz4.frame.compress(data) if compression == "lz4" else data


def decompress(compression: str, data: bytes) -> bytes:
    """The other way."""
    if compression == "zstd":
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=1 << 26)
    return lz4.frame.decompress(data) if compression == "lz4" else data


def split(data: bytes) -> list[Record]:
    """Top-level records up to the footer, or the last whole one."""
    found, at = [], len(MAGIC)
    while at + HEAD <= len(data):
        opcode, size = struct.unpack_from("<BQ", data, at)
        if at + HEAD + size > len(data):
            break
        found.append(Record(opcode, data[at + HEAD : at + HEAD + size]))
        at += HEAD + size
        if opcode == FOOTER:
            break
    return found


def join(records: Iterable[Record]) -> bytes:
    """A file of records as they are; with the closing magic where the last is a footer."""
    records = list(records)
    end = MAGIC if records and records[-1].opcode == FOOTER else b""
    return MAGIC + b"".join(r.bytes() for r in records) + end


@cache
def parse(data: bytes) -> File:
    """A good file."""
    items: list[Item] = []
    records = split(data)
    for record in records:
        if record.opcode == DATA_END:
            break
        if record.opcode == CHUNK:
            items.append(_parse_chunk(record))
        elif record.opcode == ATTACHMENT:
            items.append(_parse_attachment(record))
        elif record.opcode != MESSAGE_INDEX:
            items.append(record)
    return File(tuple(items), finished=bool(records) and records[-1].opcode == FOOTER)


def _parse_chunk(record: Record) -> Chunk:
    compression, at = _text(record.body, 28)
    return Chunk(compression, tuple(inner_records(decompress(compression, record.body[at + 8 :]))))


def inner_records(data: bytes) -> list[Record]:
    """Records of a chunk."""
    found, at = [], 0
    while at < len(data):
        opcode, size = struct.unpack_from("<BQ", data, at)
        found.append(Record(opcode, data[at + HEAD : at + HEAD + size]))
        at += HEAD + size
    return found


def _parse_attachment(record: Record) -> Attachment:
    log_time, create_time = struct.unpack_from("<QQ", record.body)
    name, at = _text(record.body, 16)
    media_type, at = _text(record.body, at)
    return Attachment(name, media_type, record.body[at + 8 : -4], log_time, create_time)


@dataclass
class _Writer:
    out: bytearray = field(default_factory=lambda: bytearray(MAGIC))

    def add(self, record: Record) -> None:
        self.out += record.bytes()


def assemble(file: File, *, index: bool = True) -> bytes:
    """A file that is right in every CRC, index and summary, whatever its records hold.

    index  False leaves the message indexes out
    """
    writer = _Writer()
    for item in file.items:
        if isinstance(item, Chunk):
            raw = b"".join(r.bytes() for r in item.records)
            writer.add(pack_chunk(item.compression, raw, compress(item.compression, raw)))
            for record in _index(item) if index else ():
                writer.add(record)
        elif isinstance(item, Attachment):
            head = struct.pack("<QQ", item.log_time, item.create_time) + pack_text(item.name)
            body = head + pack_text(item.media_type) + struct.pack("<Q", len(item.data)) + item.data
            writer.add(Record(ATTACHMENT, body + struct.pack("<I", zlib.crc32(body))))
        else:
            writer.add(item)
    if not file.finished:
        return bytes(writer.out)
    writer.add(Record(DATA_END, struct.pack("<I", zlib.crc32(writer.out))))
    begin = len(writer.out)
    for record in dict.fromkeys(r for r in file.records() if r.opcode in (SCHEMA, CHANNEL)):
        writer.add(record)
    start = begin if len(writer.out) > begin else 0
    footer = struct.pack("<BQQQ", FOOTER, 20, start, 0)
    crc = zlib.crc32(bytes(writer.out[begin:]) + footer)
    return bytes(writer.out) + footer + struct.pack("<I", crc) + MAGIC


def _index(chunk: Chunk) -> list[Record]:
    entries: dict[int, list[tuple[int, int]]] = {}
    at = 0
    for record in chunk.records:
        if record.opcode == MESSAGE and len(record.body) >= _MESSAGE.size:
            message = Message.of(record)
            entries.setdefault(message.channel, []).append((message.log_time, at))
        at += HEAD + len(record.body)
    packed = {n: b"".join(struct.pack("<QQ", *entry) for entry in found) for n, found in entries.items()}
    return [Record(MESSAGE_INDEX, struct.pack("<HI", n, len(body)) + body) for n, body in packed.items()]


def with_right_crcs(data: bytes) -> bytes:
    """The file with every CRC made right that can still be found, so that a change gets past them."""
    out = bytearray(data)
    at = len(MAGIC)
    begin_of_summary = 0
    while at + HEAD <= len(out):
        opcode, size = struct.unpack_from("<BQ", out, at)
        begin, end = at + HEAD, at + HEAD + size
        if end > len(out):
            break
        if opcode == CHUNK and size >= 40:
            _right_chunk(out, begin, end)
        elif opcode == ATTACHMENT and size >= 32:
            struct.pack_into("<I", out, end - 4, zlib.crc32(out[begin : end - 4]))
        elif opcode == DATA_END and size >= 4:
            struct.pack_into("<I", out, begin, zlib.crc32(out[:at]))
            begin_of_summary = end
        elif opcode == FOOTER and size >= 20:
            start = struct.unpack_from("<Q", out, begin)[0] or begin_of_summary
            struct.pack_into("<I", out, begin + 16, zlib.crc32(out[min(start, begin) : begin + 16]))
            break
        at = end
    return bytes(out)


def _right_chunk(out: bytearray, begin: int, end: int) -> None:
    (size,) = struct.unpack_from("<I", out, begin + 28)
    name = bytes(out[begin + 32 : begin + 32 + min(size, 8)]).decode("ascii", "replace")
    stored = bytes(out[begin + 32 + size + 8 : end]) if size < 8 else b""
    try:
        raw = decompress(name, stored)
    except Exception:  # what does not decompress has no CRC to be made right
        return
    struct.pack_into("<I", out, begin + 24, zlib.crc32(raw))


def lengths(data: bytes) -> list[tuple[int, int]]:
    """Offset and width [byte] of every length that a good file has, those in uncompressed chunks too."""
    found: list[tuple[int, int]] = []
    at = len(MAGIC)
    for record in split(data):
        found.append((at + 1, 8))
        found += _lengths(record, at + HEAD)
        at += HEAD + len(record.body)
    return found


def _lengths(record: Record, at: int) -> list[tuple[int, int]]:
    texts = {HEADER: (0, 2), SCHEMA: (2, 3), CHANNEL: (4, 3), METADATA: (0, 2), ATTACHMENT: (16, 2), CHUNK: (28, 1)}
    found: list[tuple[int, int]] = []
    if record.opcode == MESSAGE_INDEX:
        return [(at + 2, 4)]
    if record.opcode == FOOTER:
        return [(at, 8), (at + 8, 8)]
    if record.opcode not in texts:
        return found
    position, count = texts[record.opcode]
    for _ in range(count):
        found.append((at + position, 4))
        position += 4 + int(struct.unpack_from("<I", record.body, position)[0])
    if record.opcode in (ATTACHMENT, CHUNK):
        found.append((at + position, 8))
        position += 8
    if record.opcode == CHUNK:
        found.append((at + 16, 8))
        if not struct.unpack_from("<I", record.body, 28)[0]:
            for inner in inner_records(record.body[position:]):
                found.append((at + position + 1, 8))
                found += _lengths(inner, at + position + HEAD)
                position += HEAD + len(inner.body)
    return found
