"""An MCAP file as messages and attachments, also when its end is missing.

The file is mapped, and its top-level records are walked once: a few hundred bytes of headers. A message of an
uncompressed chunk is a view of the mapping. Every chunk, every attachment and the summary is checked against its CRC
before the first use of its bytes, and every length against the bytes that are there.

What a stranger's file can cost is bounded by its size, see docs/strangers.md.
"""

from __future__ import annotations

import mmap
import os
import stat
import struct
import zlib
from array import array
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from schemas import FORMAT, decompression
from schemas.errors import DamagedRecording, NotARecording
from schemas.mcap_writer import MAGIC

MAX_CHUNK_BYTES = decompression.MAX_BYTES

MAX_ATTACHMENT_BYTES = 1 << 30
"""A larger attachment is refused before it is read."""

_FREE_MESSAGES = 1 << 20
_LEAST_MESSAGE = 2
"""Any file may have _FREE_MESSAGES messages; more have to take _LEAST_MESSAGE bytes each, also when compressed."""

_MAX_NAME = 1024
_CACHED_CHUNKS = 4
_CACHED_BYTES = 64 << 20  # of decompressed chunks; the one read last is kept whatever it takes
_HELD_BYTES = 64 << 20  # of messages that wait for those before them

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = range(1, 8)
_ATTACHMENT, _METADATA, _DATA_END = 9, 12, 15

_OF_DATA = (_MESSAGE, _CHUNK, _MESSAGE_INDEX, _ATTACHMENT, _METADATA, _DATA_END)
_RECORD_HEAD = 9
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_INDEX_ENTRY = struct.Struct("<QQ")


@dataclass(frozen=True)
class Channel:
    """A channel: its topic, the name of its message type, and its metadata."""

    topic: str
    message: str
    metadata: dict[str, str]


@dataclass(frozen=True, slots=True)
class Message:
    """Where a message is: channel, chunk number (-1: outside of any), offset of its record in the chunk or file."""

    channel: int
    log_time: int
    chunk: int
    offset: int


@dataclass(frozen=True)
class _Chunk:
    compression: str
    uncompressed_size: int
    crc: int
    begin: int
    end: int


@dataclass(frozen=True)
class _Attachment:
    media_type: str
    begin: int
    end: int
    record: int
    crc: int


class _Cursor:
    """Reads the fields of one record; running past its end is damage."""

    def __init__(self, path: Path, data: memoryview, position: int, end: int) -> None:
        self._path = path
        self._data = data
        self.position = position
        self._end = end

    def take(self, size: int) -> memoryview:
        if size > self._end - self.position:
            raise DamagedRecording(f"{self._path}: a record at byte {self.position} is shorter than it says")
        part = self._data[self.position : self.position + size]
        self.position += size
        return part

    def u16(self) -> int:
        return int.from_bytes(self.take(2), "little")

    def u32(self) -> int:
        return int.from_bytes(self.take(4), "little")

    def u64(self) -> int:
        return int.from_bytes(self.take(8), "little")

    def text(self) -> str:
        try:
            return bytes(self.take(self.u32())).decode()
        except UnicodeDecodeError:
            raise DamagedRecording(f"{self._path}: a name at byte {self.position} is not UTF-8") from None

    def name(self) -> str:
        text = self.text()
        if len(text) > _MAX_NAME:
            raise DamagedRecording(f"{self._path}: the name at byte {self.position} has {len(text)} characters")
        return text

    def text_map(self) -> dict[str, str]:
        end = self.u32() + self.position
        values = {}
        while self.position < end:
            key = self.text()
            values[key] = self.text()
        return values


class Container:
    """The messages and attachments of one file.

    finished  whether the file has its footer; without, it is read up to its last whole record
    channels  by topic, in order of appearance
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._map = _mapped(path)
        self._data = memoryview(self._map)
        if self._data[: len(MAGIC)] != MAGIC:
            raise NotARecording(f"{path} is not an MCAP file")
        self.finished = False
        self.channels: dict[str, Channel] = {}
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, str] = {}
        self._numbers: dict[str, list[int]] = {}  # channels of a topic
        self._chunks: list[_Chunk] = []
        self._attachments: dict[str, _Attachment] = {}
        self._messages: dict[int, array[int]] = {}  # by channel: log time, chunk + 1 and offset of each, flat
        self._message_count = 0
        self._data_end: int | None = None  # where that record begins
        self._data_crc = 0
        self._opened: OrderedDict[int, memoryview] = OrderedDict()
        self._verified: set[int] = set()
        self._walk()

    def messages(self, topic: str) -> list[Message]:
        """The messages of a topic, all channels of it, in order of log time."""
        return sorted(self._found(topic), key=lambda m: (m.log_time, m.chunk, m.offset))

    def _found(self, topic: str) -> Iterator[Message]:
        for number in self._numbers.get(topic, ()):
            yield from self._entries(number)

    def _entries(self, channel: int) -> Iterator[Message]:
        entries = iter(self._messages.get(channel, ()))
        for log_time, chunk, offset in zip(entries, entries, entries, strict=True):
            yield Message(channel, log_time, chunk - 1, offset)

    def read(self, message: Message) -> tuple[int, memoryview]:
        """Sequence number and content of a message."""
        data = self._whole() if message.chunk < 0 else self._open_chunk(message.chunk)
        if message.offset + _RECORD_HEAD + _MESSAGE_HEAD.size > len(data):
            raise self._damaged("an index points past the end of its chunk")
        opcode = data[message.offset]
        size = int.from_bytes(data[message.offset + 1 : message.offset + _RECORD_HEAD], "little")
        begin = message.offset + _RECORD_HEAD
        if opcode != _MESSAGE or size > len(data) - begin or size < _MESSAGE_HEAD.size:
            raise self._damaged("an index points to something that is no message")
        channel, sequence, log_time, _ = _MESSAGE_HEAD.unpack_from(data, begin)
        if (channel, log_time) != (message.channel, message.log_time):
            raise self._damaged("a message and its index disagree on its topic or its time")
        return sequence, data[begin + _MESSAGE_HEAD.size : begin + size]

    def in_sequence(self, topic: str) -> Iterator[memoryview]:
        """Contents of a topic's messages in the order in which they were written; a missing one is damage."""
        # Read as they lie, so that each chunk is decompressed once; what comes too early waits, as a copy.
        waiting: dict[int, memoryview] = {}
        expected = held = 0
        for message in sorted(self._found(topic), key=lambda m: (m.chunk, m.offset)):
            sequence, content = self.read(message)
            if sequence < expected or sequence in waiting:
                raise self._damaged(f"message {sequence} of {topic} is there twice")
            if sequence > expected:
                held += len(content) + _MESSAGE_HEAD.size
                if held > _HELD_BYTES:
                    raise self._damaged(f"message {expected} of {topic} is missing, or far behind those after it")
                waiting[sequence] = memoryview(bytes(content))
                continue
            yield content
            expected += 1
            while expected in waiting:
                content = waiting.pop(expected)
                held -= len(content) + _MESSAGE_HEAD.size
                yield content
                expected += 1
        if waiting:
            raise self._damaged(f"message {expected} of {topic} is missing")

    def attachment(self, name: str) -> bytes | None:
        """An attachment's bytes, checked against its CRC; None where there is none of that name."""
        found = self._attachments.get(name)
        if found is None:
            return None
        if found.end - found.begin > MAX_ATTACHMENT_BYTES:
            raise self._damaged(f"the attachment {name} has more than the {MAX_ATTACHMENT_BYTES} bytes that are read")
        self._whole()
        if found.crc and zlib.crc32(self._data[found.record : found.end]) != found.crc:
            raise self._damaged(f"the attachment {name} fails its CRC")
        return bytes(self._data[found.begin : found.end])

    def attachment_names(self) -> list[str]:
        """Names of all attachments."""
        return list(self._attachments)

    @property
    def size(self) -> int:
        """Of the file [byte], as it was when it was opened."""
        return len(self._data)

    @cached_property
    def content_bytes(self) -> int:
        """Upper bound of what the messages hold, decompressed: no array of the file can be larger, if not packed."""
        sizes = (
            min(c.uncompressed_size, decompression.limit(c.compression, c.end - c.begin))
            for c in self._chunks
            if c.compression
        )
        return len(self._data) + sum(sizes)

    def verify(self) -> None:
        """Check the CRC of the whole data section and of every chunk; DamagedRecording names the first that fails."""
        if self._data_crc and zlib.crc32(self._whole()[: self._data_end]) != self._data_crc:
            raise self._damaged("the data section fails its CRC: bytes were changed")
        for number in range(len(self._chunks)):
            self._open_chunk(number)

    def _walk(self) -> None:
        position = len(MAGIC)
        size = len(self._data)
        indexed: set[int] = set()
        while position + _RECORD_HEAD <= size:
            opcode = self._data[position]
            length = int.from_bytes(self._data[position + 1 : position + _RECORD_HEAD], "little")
            begin, end = position + _RECORD_HEAD, position + _RECORD_HEAD + length
            if end > size or opcode == 0:  # zeros are no record: a crash leaves them where bytes never arrived
                break
            cursor = _Cursor(self.path, self._data, begin, end)
            if (position == len(MAGIC)) != (opcode == _HEADER):
                raise self._damaged("the file does not begin with a header, or has a second one")
            if opcode == _FOOTER:
                self._end(cursor, begin, end)
                break
            if opcode == _HEADER:
                self._check_profile(cursor.name())
            elif opcode in (_SCHEMA, _CHANNEL):
                self._declare(opcode, cursor)
            elif self._data_end is not None:
                if opcode in _OF_DATA:
                    raise self._damaged("data follow behind the end of the data")
            elif opcode == _MESSAGE:
                channel, _, log_time, _ = _MESSAGE_HEAD.unpack(cursor.take(_MESSAGE_HEAD.size))
                self._add(channel, log_time, -1, position)
            elif opcode == _CHUNK:
                self._add_chunk(cursor)
            elif opcode == _MESSAGE_INDEX and self._chunks:
                indexed.add(len(self._chunks) - 1)
                self._add_index(cursor)
            elif opcode == _ATTACHMENT:
                self._add_attachment(cursor, begin)
            elif opcode == _DATA_END:
                self._data_end, self._data_crc = position, cursor.u32()
            position = end
        if not self.finished:
            # no CRC covers an index, and what a crash left may lack some: the chunks themselves are asked
            indexed.clear()
            self._forget_index()
        for number in range(len(self._chunks)):
            # Without a summary the channels are only declared inside the chunks.
            if number not in indexed:
                self._scan_chunk(number)
        missing = set(self._messages) - set(self._topics)
        if self.finished and missing:
            raise self._damaged(f"messages of an undeclared channel {min(missing)}")

    def _end(self, cursor: _Cursor, begin: int, end: int) -> None:
        summary, offsets, crc = cursor.u64(), cursor.u64(), cursor.u32()
        if self._data[end : end + len(MAGIC)] != MAGIC:
            return  # cut short within the last bytes
        if end + len(MAGIC) != len(self._data):
            raise self._damaged(f"{len(self._data) - end - len(MAGIC)} bytes follow behind the end of the file")
        if self._data_end is None:
            raise self._damaged("the data section does not end")
        if not all(at == 0 or self._data_end < at <= begin for at in (summary, offsets)):
            raise self._damaged("the footer points to no summary")
        if crc and zlib.crc32(self._data[summary or begin - _RECORD_HEAD : end - 4]) != crc:
            raise self._damaged("the summary fails its CRC: bytes were changed")
        self.finished = True

    def _forget_index(self) -> None:
        outside = {number: [m for m in self._entries(number) if m.chunk < 0] for number in self._messages}
        self._messages, self._message_count = {}, 0
        for number, messages in outside.items():
            for m in messages:
                self._add(number, m.log_time, -1, m.offset)

    def _damaged(self, what: str) -> DamagedRecording:
        return DamagedRecording(f"{self.path}: {what}")

    def _whole(self) -> memoryview:
        # Touching a page that the file has no more would end the process with SIGBUS.
        if self._map.size() < len(self._data):
            raise self._damaged("the file became shorter while it was read")
        return self._data

    def _check_profile(self, profile: str) -> None:
        family = FORMAT.partition(".")[0]
        if profile == FORMAT:
            return
        if profile.startswith(f"{family}."):
            raise NotARecording(f"{self.path} has format {profile}, this version reads {FORMAT}: update gpusimbench")
        raise NotARecording(
            f"{self.path} is an MCAP file, but not a recording of a simulator (profile '{profile}', not '{FORMAT}')"
        )

    def _declare(self, opcode: int, cursor: _Cursor) -> None:
        number = cursor.u16()
        if opcode == _SCHEMA:
            name = cursor.name()
            if self._schemas.setdefault(number, name) != name:
                raise self._damaged(f"schema {number} has two names")
            return
        schema, topic = cursor.u16(), cursor.name()
        cursor.text()  # message encoding; the format has one
        if self._topics.setdefault(number, topic) != topic:
            raise self._damaged(f"channel {number} has two topics")
        channel = Channel(topic, self._schemas.get(schema, ""), cursor.text_map())
        if self.channels.setdefault(topic, channel) != channel:
            raise self._damaged(f"the topic {topic} is declared twice, not the same")
        numbers = self._numbers.setdefault(topic, [])
        if number not in numbers:
            numbers.append(number)

    def _add(self, channel: int, log_time: int, chunk: int, offset: int) -> None:
        self._message_count += 1
        if self._message_count > _FREE_MESSAGES + len(self._data) // _LEAST_MESSAGE:
            raise self._damaged(f"it announces more than {self._message_count - 1} messages, which is refused")
        self._messages.setdefault(channel, array("Q")).extend((log_time, chunk + 1, offset))

    def _add_index(self, cursor: _Cursor) -> None:
        channel = cursor.u16()
        entries = cursor.take(cursor.u32())
        if len(entries) % _INDEX_ENTRY.size:
            raise self._damaged("a message index has half an entry")
        for log_time, offset in _INDEX_ENTRY.iter_unpack(entries):
            self._add(channel, log_time, len(self._chunks) - 1, offset)

    def _add_chunk(self, cursor: _Cursor) -> None:
        cursor.take(16)  # first and last log time
        uncompressed_size, crc, compression = cursor.u64(), cursor.u32(), cursor.name()
        stored = cursor.u64()
        begin = cursor.position
        cursor.take(stored)
        self._chunks.append(_Chunk(compression, uncompressed_size, crc, begin, begin + stored))

    def _add_attachment(self, cursor: _Cursor, begin: int) -> None:
        cursor.take(16)  # log time and creation time
        name, media_type = cursor.name(), cursor.name()
        size = cursor.u64()
        data = cursor.position
        cursor.take(size)
        if name in self._attachments:
            raise self._damaged(f"the attachment {name} is there twice")
        self._attachments[name] = _Attachment(media_type, data, data + size, begin, cursor.u32())

    def _scan_chunk(self, number: int) -> None:
        data = self._open_chunk(number)
        position = 0
        while position < len(data):
            cursor = _Cursor(self.path, data, position, len(data))
            opcode = cursor.take(1)[0]
            length = cursor.u64()
            begin = cursor.position
            cursor.take(length)
            if opcode in (_SCHEMA, _CHANNEL):
                self._declare(opcode, _Cursor(self.path, data, begin, begin + length))
            elif opcode == _MESSAGE:
                record = _Cursor(self.path, data, begin, begin + length)
                channel, _, log_time, _ = _MESSAGE_HEAD.unpack(record.take(_MESSAGE_HEAD.size))
                self._add(channel, log_time, number, position)
            position = begin + length

    def _open_chunk(self, number: int) -> memoryview:
        if number in self._opened:
            self._opened.move_to_end(number)
            return self._opened[number]
        chunk = self._chunks[number]
        stored = self._whole()[chunk.begin : chunk.end]
        try:
            data = decompression.decompress(chunk.compression, stored, chunk.uncompressed_size)
        except ValueError as error:
            raise self._damaged(f"the chunk at byte {chunk.begin} is damaged: {error}") from None
        if number not in self._verified:
            if chunk.crc and zlib.crc32(data) != chunk.crc:
                raise self._damaged(f"a chunk at byte {chunk.begin} fails its CRC")
            self._verified.add(number)
        self._opened[number] = data
        kept = sum(len(self._opened[n]) for n in self._opened if self._chunks[n].compression)
        while len(self._opened) > 1 and (kept > _CACHED_BYTES or len(self._opened) > _CACHED_CHUNKS):
            oldest, dropped = self._opened.popitem(last=False)
            kept -= len(dropped) if self._chunks[oldest].compression else 0
        return data


def _mapped(path: Path) -> mmap.mmap:
    try:
        # without O_NONBLOCK, opening a pipe would wait for its writer
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as error:
        raise NotARecording(f"cannot read {path}: {getattr(error, 'strerror', error)}") from None
    try:
        found = os.fstat(descriptor)
        if stat.S_ISDIR(found.st_mode):
            raise NotARecording(f"cannot read {path}: Is a directory")
        if not stat.S_ISREG(found.st_mode):
            raise NotARecording(f"{path} is not a file")
        if found.st_size < len(MAGIC):
            raise NotARecording(f"{path} is not an MCAP file: it has fewer than {len(MAGIC)} bytes")
        return mmap.mmap(descriptor, 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:
        raise NotARecording(f"cannot read {path}: {getattr(error, 'strerror', error)}") from None
    finally:
        os.close(descriptor)
