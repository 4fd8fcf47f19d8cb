"""An MCAP file as messages and attachments, also when its end is missing.

The file is mapped, and its top-level records are walked once: a few hundred bytes of headers. A message of an
uncompressed chunk is a view of the mapping. Every chunk and attachment is checked against its CRC before the first use
of its bytes, and every length against the bytes that are there.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from schemas import FORMAT
from schemas.errors import DamagedRecording, NotARecording

MAGIC = b"\x89MCAP0\r\n"

MAX_CHUNK_BYTES = 1 << 30
"""A chunk that announces more uncompressed bytes is refused before anything is allocated."""

_CACHED_CHUNKS = 4

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = range(1, 8)
_ATTACHMENT, _METADATA, _DATA_END = 9, 12, 15
_RECORD_HEAD = 9
_MESSAGE_HEAD = struct.Struct("<HIQQ")


@dataclass(frozen=True)
class Channel:
    """A channel: its topic, the name of its message type, and its metadata."""

    topic: str
    message: str
    metadata: dict[str, str]


@dataclass(frozen=True)
class Message:
    """Where a message is: chunk number (-1: outside of any) and offset of its record within the chunk or file."""

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

    def __init__(self, data: memoryview, position: int, end: int) -> None:
        self._data = data
        self.position = position
        self._end = end

    def take(self, size: int) -> memoryview:
        if size > self._end - self.position:
            raise DamagedRecording(f"a record at byte {self.position} is shorter than it says")
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
            raise DamagedRecording(f"a name at byte {self.position} is not UTF-8") from None

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
        try:
            if path.exists() and not path.is_file() and not path.is_dir():
                raise NotARecording(f"{path} is not a file")  # opening a pipe would wait for its writer
            with path.open("rb") as stream:
                if os.fstat(stream.fileno()).st_size < len(MAGIC):
                    raise NotARecording(f"{path} is not an MCAP file: it has fewer than {len(MAGIC)} bytes")
                self._map = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except OSError as error:
            raise NotARecording(f"cannot read {path}: {error.strerror}") from None
        self._data = memoryview(self._map)
        if self._data[: len(MAGIC)] != MAGIC:
            raise NotARecording(f"{path} is not an MCAP file")
        self.finished = False
        self.channels: dict[str, Channel] = {}
        self._schemas: dict[int, str] = {}
        self._topics: dict[int, str] = {}
        self._chunks: list[_Chunk] = []
        self._attachments: dict[str, _Attachment] = {}
        self._messages: dict[int, list[Message]] = {}
        self._data_end = 0
        self._data_crc = 0
        self._opened: OrderedDict[int, memoryview] = OrderedDict()
        self._verified: set[int] = set()
        self._walk()

    def messages(self, topic: str) -> list[Message]:
        """The messages of a topic, all channels of it, in order of log time."""
        found = [m for number, name in self._topics.items() if name == topic for m in self._messages.get(number, ())]
        return sorted(found, key=lambda m: (m.log_time, m.chunk, m.offset))

    def read(self, message: Message) -> tuple[int, memoryview]:
        """Sequence number and content of a message."""
        data = self._data if message.chunk < 0 else self._open_chunk(message.chunk)
        if message.offset + _RECORD_HEAD + _MESSAGE_HEAD.size > len(data):
            raise DamagedRecording(f"{self.path}: an index points past the end of its chunk")
        opcode = data[message.offset]
        size = int.from_bytes(data[message.offset + 1 : message.offset + _RECORD_HEAD], "little")
        begin = message.offset + _RECORD_HEAD
        if opcode != _MESSAGE or size > len(data) - begin or size < _MESSAGE_HEAD.size:
            raise DamagedRecording(f"{self.path}: an index points to something that is no message")
        _, sequence, log_time, _ = _MESSAGE_HEAD.unpack_from(data, begin)
        if log_time != message.log_time:
            raise DamagedRecording(f"{self.path}: a message and its index disagree on its time")
        return sequence, data[begin + _MESSAGE_HEAD.size : begin + size]

    def in_sequence(self, topic: str) -> Iterator[memoryview]:
        """Contents of a topic's messages in the order in which they were written; a missing one is damage."""
        read = sorted((self.read(m) for m in self.messages(topic)), key=lambda pair: pair[0])
        for expected, (sequence, content) in enumerate(read):
            if sequence != expected:
                raise DamagedRecording(f"{self.path}: message {expected} of {topic} is missing")
            yield content

    def attachment(self, name: str) -> bytes | None:
        """An attachment's bytes, checked against its CRC; None where there is none of that name."""
        found = self._attachments.get(name)
        if found is None:
            return None
        if found.crc and zlib.crc32(self._data[found.record : found.end]) != found.crc:
            raise DamagedRecording(f"{self.path}: the attachment {name} fails its CRC")
        return bytes(self._data[found.begin : found.end])

    def attachment_names(self) -> list[str]:
        """Names of all attachments."""
        return list(self._attachments)

    @property
    def content_bytes(self) -> int:
        """Upper bound of what the messages hold, decompressed: no array of the file can be larger."""
        return len(self._data) + sum(c.uncompressed_size for c in self._chunks if c.compression)

    def verify(self) -> None:
        """Check the CRC of the whole data section and of every chunk; DamagedRecording names the first that fails."""
        if self._data_crc and zlib.crc32(self._data[: self._data_end]) != self._data_crc:
            raise DamagedRecording(f"{self.path}: the data section fails its CRC: bytes were changed")
        for number in range(len(self._chunks)):
            self._open_chunk(number)

    def _walk(self) -> None:
        position = len(MAGIC)
        size = len(self._data)
        indexed: set[int] = set()
        first = True
        while position + _RECORD_HEAD <= size:
            opcode = self._data[position]
            length = int.from_bytes(self._data[position + 1 : position + _RECORD_HEAD], "little")
            begin, end = position + _RECORD_HEAD, position + _RECORD_HEAD + length
            if end > size:
                break
            cursor = _Cursor(self._data, begin, end)
            if first and opcode != _HEADER:
                raise DamagedRecording(f"{self.path}: the file does not begin with a header")
            if opcode == _HEADER:
                self._check_profile(cursor.text())
            elif opcode in (_SCHEMA, _CHANNEL):
                self._declare(opcode, cursor)
            elif opcode == _MESSAGE:
                channel, _, log_time, _ = _MESSAGE_HEAD.unpack(cursor.take(_MESSAGE_HEAD.size))
                self._add(channel, Message(log_time, -1, position))
            elif opcode == _CHUNK:
                self._add_chunk(cursor)
            elif opcode == _MESSAGE_INDEX and self._chunks:
                number = len(self._chunks) - 1
                indexed.add(number)
                channel = cursor.u16()
                stop = cursor.u32() + cursor.position
                while cursor.position < stop:
                    self._add(channel, Message(cursor.u64(), number, cursor.u64()))
            elif opcode == _ATTACHMENT:
                self._add_attachment(cursor, begin, end)
            elif opcode == _DATA_END:
                self._data_end, self._data_crc = position, cursor.u32()
            elif opcode == _FOOTER:
                self.finished = self._data[end : end + len(MAGIC)] == MAGIC
                break
            first = False
            position = end
        for number in range(len(self._chunks)):
            # Without a summary the channels are only declared inside the chunks.
            if not self.finished or number not in indexed:
                self._scan_chunk(number, with_messages=number not in indexed)
        missing = set(self._messages) - set(self._topics)
        if self.finished and missing:
            raise DamagedRecording(f"{self.path}: messages of an undeclared channel {min(missing)}")

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
            self._schemas[number] = cursor.text()
            return
        schema, topic = cursor.u16(), cursor.text()
        cursor.text()  # message encoding; the format has one
        self._topics[number] = topic
        self.channels[topic] = Channel(topic, self._schemas.get(schema, ""), cursor.text_map())

    def _add(self, channel: int, message: Message) -> None:
        self._messages.setdefault(channel, []).append(message)

    def _add_chunk(self, cursor: _Cursor) -> None:
        cursor.take(16)  # first and last log time
        uncompressed_size, crc, compression = cursor.u64(), cursor.u32(), cursor.text()
        stored = cursor.u64()
        begin = cursor.position
        cursor.take(stored)
        self._chunks.append(_Chunk(compression, uncompressed_size, crc, begin, begin + stored))

    def _add_attachment(self, cursor: _Cursor, begin: int, end: int) -> None:
        cursor.take(16)  # log time and creation time
        name, media_type = cursor.text(), cursor.text()
        size = cursor.u64()
        data = cursor.position
        cursor.take(size)
        if name in self._attachments:
            raise DamagedRecording(f"{self.path}: the attachment {name} is there twice")
        self._attachments[name] = _Attachment(media_type, data, data + size, begin, cursor.u32())

    def _scan_chunk(self, number: int, *, with_messages: bool) -> None:
        data = self._open_chunk(number)
        position = 0
        while position < len(data):
            cursor = _Cursor(data, position, len(data))
            opcode = cursor.take(1)[0]
            length = cursor.u64()
            begin = cursor.position
            cursor.take(length)
            if opcode in (_SCHEMA, _CHANNEL):
                self._declare(opcode, _Cursor(data, begin, begin + length))
            elif opcode == _MESSAGE and with_messages:
                record = _Cursor(data, begin, begin + length)
                channel = record.u16()
                record.u32()
                self._add(channel, Message(record.u64(), number, position))
            position = begin + length

    def _open_chunk(self, number: int) -> memoryview:
        if number in self._opened:
            self._opened.move_to_end(number)
            return self._opened[number]
        chunk = self._chunks[number]
        data = self._decompress(chunk)
        if number not in self._verified:
            if chunk.crc and zlib.crc32(data) != chunk.crc:
                raise DamagedRecording(f"{self.path}: a chunk at byte {chunk.begin} fails its CRC")
            self._verified.add(number)
        self._opened[number] = data
        if len(self._opened) > _CACHED_CHUNKS:
            self._opened.popitem(last=False)
        return data

    def _decompress(self, chunk: _Chunk) -> memoryview:
        stored = self._data[chunk.begin : chunk.end]
        if not chunk.compression:
            return stored
        if chunk.uncompressed_size > MAX_CHUNK_BYTES:
            raise DamagedRecording(f"{self.path}: a chunk announces {chunk.uncompressed_size} bytes, which is refused")
        unpack = _UNPACK.get(chunk.compression)
        if unpack is None:
            raise DamagedRecording(f"{self.path}: chunks are compressed with {chunk.compression}, not known here")
        try:
            data = unpack(stored, chunk.uncompressed_size)
        except Exception as error:  # each library has its own; all mean that the bytes are not what they should be
            raise DamagedRecording(f"{self.path}: a chunk cannot be decompressed: {error}") from None
        if len(data) != chunk.uncompressed_size:
            raise DamagedRecording(f"{self.path}: a chunk holds another number of bytes than it announces")
        return memoryview(data)


def _unpack_zstd(stored: memoryview, size: int) -> bytes:
    import zstandard

    # the size in the frame decides what is allocated, whatever the limit asked for
    if zstandard.frame_content_size(stored) > size:
        raise ValueError("it holds more than it announces")
    return zstandard.ZstdDecompressor().decompress(stored, max_output_size=size)


def _unpack_lz4(stored: memoryview, size: int) -> bytes:
    import lz4.frame

    with lz4.frame.LZ4FrameDecompressor() as frame:
        data: bytes = frame.decompress(bytes(stored), max_length=size)
        return data


_UNPACK = {"zstd": _unpack_zstd, "lz4": _unpack_lz4}
