"""An MCAP file as messages and attachments, also when its end is missing.

A file of this machine is mapped, and its top-level records are walked once: a few hundred bytes of headers. A message
of an uncompressed chunk is a view of the mapping. A file elsewhere is opened through its summary (schemas.index), and
its parts are read when they are needed; without a summary it is walked, too. Every chunk, every attachment and the
summary is checked against its CRC before its content is used (`Container.peek` tells the exception), and every length
against the bytes that are there.

What a stranger's file can cost is bounded by its size, see docs/strangers.md.
"""

from __future__ import annotations

import logging
import zlib
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from struct import Struct

from gpusimbench.schemas import FORMAT, decompression
from gpusimbench.schemas.chunks import Chunks
from gpusimbench.schemas.crc import combine, second
from gpusimbench.schemas.cursor import Cursor
from gpusimbench.schemas.declarations import Channel, Declarations
from gpusimbench.schemas.errors import DamagedRecording, NotARecording
from gpusimbench.schemas.index import Index, IndexedChunk, read_index
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.mcap_writer import MAGIC
from gpusimbench.schemas.parts import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEAD,
    SCHEMA,
    Attachment,
    Chunk,
    check_head,
    read_attachment,
    read_chunk,
)
from gpusimbench.schemas.source import Source, open_source

MAX_CHUNK_BYTES = decompression.MAX_BYTES

MAX_ATTACHMENT_BYTES = 1 << 30
"""A larger attachment is refused before it is read."""

MAX_ATTACHMENTS = 4096
"""A file with more is refused."""

MAX_HEADER_BYTES = 64 << 10
"""A file elsewhere with a longer header is refused before that is read."""

MAX_INDEX_BYTES = 1 << 30
"""The same of the index of a chunk's messages, and of a declaration beside the chunks."""

MAX_WALKED_BYTES = 1 << 30
"""A file elsewhere that has no index is read as a whole, unless it is larger."""

_FREE_MESSAGES = 1 << 20
_LEAST_MESSAGE = 8
"""Any file may have _FREE_MESSAGES messages; more have to take _LEAST_MESSAGE bytes each, also when compressed."""

_HELD_BYTES = 64 << 20  # of messages that wait for those before them
_PIECE_BYTES = 4 << 20  # that a CRC is computed of at once
_CHEAP_BYTES = 4096  # whose CRC costs nothing beside that of a chunk

_BETWEEN = (SCHEMA, CHANNEL, MESSAGE_INDEX, ATTACHMENT, METADATA)  # chunks, of what MCAP defines
_OF_DATA = (MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END)
_INDEX_ENTRY = Struct("<QQ")

_log = logging.getLogger(__name__)


def most_messages(size: int) -> int:
    """Messages that are read of a file of so many bytes."""
    return _FREE_MESSAGES + size // _LEAST_MESSAGE


@dataclass(frozen=True, slots=True)
class Message:
    """Where a message is: channel, chunk number (-1: outside of any), offset of its record in the chunk or file.

    The offset of one that its chunk holds alone may be that of a record ahead of it.
    """

    channel: int
    log_time: int
    chunk: int
    offset: int


class Container:
    """The messages and attachments of one file.

    path      of the file
    finished  whether the file has its footer; without, it is read up to its last whole record
    indexed   whether it was opened through its summary
    library   that wrote it, by its own word
    channels  by topic, in order of appearance
    """

    def __init__(self, path: Place, source: Source | None = None) -> None:
        self.path = path
        self._source = source or open_source(path)
        if self._source.size < len(MAGIC) or self._source.read(0, len(MAGIC)) != MAGIC:
            raise NotARecording(f"{path} is not an MCAP file")
        self.finished = False
        self.library = ""
        self._declared = Declarations(path)
        self._chunks = Chunks(path, self._source)
        self._attachments: dict[str, Attachment] = {}
        self._messages: dict[int, array[int]] = {}  # by channel: log time, chunk + 1 and offset of each, flat
        self._message_count = 0
        self._data_end: int | None = None  # where that record begins
        self._data_crc = 0
        self._index: tuple[IndexedChunk, ...] = ()
        self._unlisted: dict[int, list[int]] = {}  # by channel, chunks whose messages of it were not looked for yet
        self._unscanned: list[int] = []  # chunks that nothing says the messages of
        index = None if self._source.near else read_index(self._source)
        self.indexed = index is not None
        if index is not None:
            self._take(index)
        else:
            if not self._source.near:
                self._announce_walk()
            self._walk()

    @property
    def channels(self) -> dict[str, Channel]:
        """See Container."""
        return self._declared.channels

    @property
    def source(self) -> Source:
        """The file's bytes."""
        return self._source

    def messages(self, topic: str) -> list[Message]:
        """The messages of a topic, all channels of it, in order of log time."""
        return sorted(self._found(topic), key=lambda m: (m.log_time, m.chunk, m.offset))

    def _found(self, topic: str) -> Iterator[Message]:
        self._look_for(topic)
        for number in self._declared.numbers.get(topic, ()):
            yield from self._entries(number)

    def _entries(self, channel: int) -> Iterator[Message]:
        entries = iter(self._messages.get(channel, ()))
        for log_time, chunk, offset in zip(entries, entries, entries, strict=True):
            yield Message(channel, log_time, chunk - 1, offset)

    def read(self, message: Message) -> tuple[int, memoryview]:
        """Sequence number and content of a message."""
        sequence, content, _ = self.read_with_crc(message)
        return sequence, content

    def read_with_crc(self, message: Message) -> tuple[int, memoryview, int | None]:
        """The same, and the content's CRC-32 where it follows from that of its chunk, which was checked."""
        if message.chunk < 0:
            head = self._read_record(message.offset)
            return (*self._of_message(message, head, 0), None)
        data, crc = self._chunks.open(message.chunk)
        offset = message.offset if not self._sole(message.chunk) else self._sole_offset(data)
        sequence, content = self._of_message(message, data, offset)
        before = offset + RECORD_HEAD + MESSAGE_HEAD.size
        if not crc or before + len(content) != len(data) or before > _CHEAP_BYTES:
            return sequence, content, None
        return sequence, content, second(crc, zlib.crc32(data[:before]), len(content))

    def chunk_bytes(self, message: Message) -> int:
        """Of the chunk that a message is in, decompressed; of the message's head where it is in none."""
        return self._chunks[message.chunk].uncompressed_size if message.chunk >= 0 else RECORD_HEAD

    def stored_bytes(self, topic: str) -> int:
        """Of the contents of a topic's messages, at most; those that the index tells the size of are not read."""
        return sum(
            self._chunks[m.chunk].uncompressed_size - RECORD_HEAD - MESSAGE_HEAD.size
            if m.chunk >= 0 and self._sole(m.chunk)
            else self.peek(m, 0)[0]
            for m in self._found(topic)
        )

    def peek(self, message: Message, size: int) -> tuple[int, memoryview]:
        """How long a message's content is, and its first bytes, at most `size`.

        Of an uncompressed chunk nothing else is read, so that its CRC is not checked yet: what is made of these bytes
        has to be borne out by the message, once it is read.
        """
        if message.chunk >= 0 and not (chunk := self._chunks[message.chunk]).compression:
            begin = min(chunk.begin + message.offset, chunk.end)  # an index may point anywhere
            head = self._source.read(begin, min(begin + RECORD_HEAD + MESSAGE_HEAD.size + size, chunk.end))
            if len(head) >= RECORD_HEAD + MESSAGE_HEAD.size and head[0] == MESSAGE:
                length = int.from_bytes(head[1:RECORD_HEAD], "little") - MESSAGE_HEAD.size
                channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(head, RECORD_HEAD)
                if (channel, log_time) == (message.channel, message.log_time) and length >= 0:
                    return length, head[RECORD_HEAD + MESSAGE_HEAD.size :][:length]
        content = self.read(message)[1]
        return len(content), content[:size]

    def _of_message(self, message: Message, data: memoryview, offset: int) -> tuple[int, memoryview]:
        if offset + RECORD_HEAD + MESSAGE_HEAD.size > len(data):
            raise self._damaged("an index points past the end of its chunk")
        opcode = data[offset]
        size = int.from_bytes(data[offset + 1 : offset + RECORD_HEAD], "little")
        begin = offset + RECORD_HEAD
        if opcode != MESSAGE or size > len(data) - begin or size < MESSAGE_HEAD.size:
            raise self._damaged("an index points to something that is no message")
        channel, sequence, log_time, _ = MESSAGE_HEAD.unpack_from(data, begin)
        if (channel, log_time) != (message.channel, message.log_time):
            raise self._damaged("a message and its index disagree on its topic or its time")
        return sequence, data[begin + MESSAGE_HEAD.size : begin + size]

    def _sole(self, chunk: int) -> bool:
        # whether the index of the file says of a chunk that it holds one message
        return bool(self._index) and len(self._index[chunk].channels) == self._index[chunk].messages == 1

    def _sole_offset(self, data: memoryview) -> int:
        # of the only message of a chunk, behind what declares its channel; it has to be the last record
        position = 0
        while position + RECORD_HEAD <= len(data):
            end = position + RECORD_HEAD + int.from_bytes(data[position + 1 : position + RECORD_HEAD], "little")
            if data[position] not in (SCHEMA, CHANNEL):
                if end != len(data):
                    break
                return position
            position = end
        raise self._damaged("a chunk does not hold the one message that the file's index says")

    def _read_record(self, position: int, most: int | None = None) -> memoryview:
        # a top-level record, with its head; from elsewhere, one of at most that many bytes
        if position + RECORD_HEAD > self._source.size:
            raise self._damaged("an index points past the end of the file")
        length = int.from_bytes(self._source.read(position + 1, position + RECORD_HEAD), "little")
        if length > self._source.size - position - RECORD_HEAD:
            raise self._damaged("an index points past the end of the file")
        if most is not None and length > most and not self._source.near:
            raise self._damaged(
                f"the record at byte {position} has {length} bytes, more than the {most} that are read from elsewhere"
            )
        return self._source.read(position, position + RECORD_HEAD + length)

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
                held += len(content) + MESSAGE_HEAD.size
                if held > _HELD_BYTES:
                    raise self._damaged(f"message {expected} of {topic} is missing, or far behind those after it")
                waiting[sequence] = memoryview(bytes(content))
                continue
            yield content
            expected += 1
            while expected in waiting:
                content = waiting.pop(expected)
                held -= len(content) + MESSAGE_HEAD.size
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
        data = self._source.read(found.record - RECORD_HEAD, found.end + 4)
        if self.indexed:
            check_head(self.path, ATTACHMENT, data, found.end + 4 - found.record)
            cursor = Cursor(self.path, data, RECORD_HEAD, len(data), found.record - RECORD_HEAD)
            if read_attachment(cursor) != found:
                raise self._damaged(f"the attachment {name} is not what the file's index says")
        crc = int.from_bytes(data[-4:], "little")
        if crc and zlib.crc32(data[RECORD_HEAD:-4]) != crc:
            raise self._damaged(f"the attachment {name} fails its CRC")
        return bytes(data[found.begin - found.record + RECORD_HEAD : -4])

    def attachment_names(self) -> list[str]:
        """Names of all attachments."""
        return list(self._attachments)

    @property
    def size(self) -> int:
        """Of the file [byte], as it was when it was opened."""
        return self._source.size

    @property
    def chunks(self) -> tuple[Chunk, ...]:
        """All chunks, in the order of the file."""
        return tuple(self._chunks)

    @cached_property
    def content_bytes(self) -> int:
        """Upper bound of what the messages hold, decompressed: no array of the file can be larger, if not packed."""
        sizes = (
            min(c.uncompressed_size, decompression.limit(c.compression, c.end - c.begin))
            for c in self._chunks
            if c.compression
        )
        return self.size + sum(sizes)

    def verify(self) -> None:
        """Check the CRC of the whole data section and of every chunk; DamagedRecording names the first that fails.

        Of a file that was opened through its summary, also that nothing lies beside what the summary says.
        """
        self._chunks.forget()
        beside, inside = Declarations(self.path), Declarations(self.path)
        inside.schemas.update(self._declared.schemas)
        crc = position = 0
        end = self._data_end if self._data_end is not None else self.size
        for number, chunk in enumerate(self._chunks):
            self._check_between(position, chunk.record - RECORD_HEAD, number, beside)
            crc = self._crc_of(position, chunk.begin, crc)
            data, known = self._chunks.open(number)
            self._check_declarations(data, inside)
            if chunk.compression or not known:
                crc = self._crc_of(chunk.begin, chunk.end, crc)
            else:
                crc = combine(crc, known, len(data))
            position = chunk.end
        self._check_between(position, end, len(self._chunks), beside)
        if not self._declared.covers(beside):
            raise self._damaged("a channel or schema that is declared beside the chunks is not so in the file's index")
        if not self._declared.covers(inside):
            raise self._damaged("a channel or schema that is declared in a chunk is not so in the rest of the file")
        if self._data_crc and self._crc_of(position, end, crc) != self._data_crc:
            raise self._damaged("the data section fails its CRC: bytes were changed")
        self._source.confirm()

    def _check_declarations(self, data: memoryview, inside: Declarations) -> None:
        # what a chunk declares, which nobody looks at here where an index says what is in it, and other readers do
        position = 0
        while position < len(data):
            begin = position + RECORD_HEAD
            end = begin + int.from_bytes(data[position + 1 : begin], "little")
            if end > len(data):
                raise self._damaged("a chunk ends within a record")
            if data[position] in (SCHEMA, CHANNEL):
                inside.take(data[position], Cursor(self.path, data, begin, end))
            position = end

    def _crc_of(self, begin: int, end: int, crc: int) -> int:
        # of what came before, followed by these bytes
        if not self._data_crc:
            return 0
        for at in range(begin, end, _PIECE_BYTES):
            crc = zlib.crc32(self._source.read(at, min(end, at + _PIECE_BYTES)), crc)
        return crc

    def _check_between(self, begin: int, end: int, chunk: int, beside: Declarations) -> None:
        # What lies between two chunks, the latter of that number: nothing that a walk would take for something else
        # than the index does.
        if not self.indexed:
            return
        attachments = {a.record: a for a in self._attachments.values()}
        position, listed = begin or len(MAGIC), dict[int, int]()
        while position < end:
            head = self._source.read(position, min(position + RECORD_HEAD, end))
            opcode, length = head[0], int.from_bytes(head[1:RECORD_HEAD], "little")
            if len(head) < RECORD_HEAD or length > end - position - RECORD_HEAD:
                raise self._damaged(f"a record at byte {position} reaches into the next")
            if opcode == MESSAGE_INDEX and chunk:
                channel = self._check_index(position, chunk - 1)
                if listed.setdefault(channel, position) != position:
                    raise self._damaged(f"the messages of a channel are listed twice, at byte {position} again")
            elif opcode == ATTACHMENT:
                self._check_attachment(attachments.get(position + RECORD_HEAD), position, length)
            elif opcode in (SCHEMA, CHANNEL):
                record = self._read_record(position, MAX_INDEX_BYTES)
                beside.take(opcode, Cursor(self.path, record, RECORD_HEAD, len(record), position))
            elif (opcode <= DATA_END and opcode not in (*_BETWEEN, HEADER)) or (
                (opcode == HEADER) != (position == len(MAGIC))
            ):
                raise self._damaged(f"a record of type {opcode} at byte {position} is not in the file's index")
            position += RECORD_HEAD + length
        known = self._index[chunk - 1] if chunk else None
        if listed != (dict(zip(known.channels, known.places, strict=True)) if known else {}):
            raise self._damaged(f"the index of the messages ahead of byte {end} is not what the file's index says")

    def _check_index(self, position: int, number: int) -> int:
        # An index of messages points to messages of its channel, where it is never read, too; returns the channel.
        record = self._read_record(position, MAX_INDEX_BYTES)
        cursor = Cursor(self.path, record, RECORD_HEAD, len(record), position)
        channel, entries = self._entries_of(cursor)
        data, _ = self._chunks.open(number)
        for log_time, offset in _INDEX_ENTRY.iter_unpack(entries):
            self._of_message(Message(channel, log_time, number, offset), data, offset)
        if self._sole(number):
            expected = _INDEX_ENTRY.pack(self._index[number].first_time, self._sole_offset(data))
            if entries != expected:
                raise self._damaged(f"the index at byte {position} and the file's disagree on the chunk's only message")
        return channel

    def _check_attachment(self, known: Attachment | None, position: int, length: int) -> None:
        begin = position + RECORD_HEAD
        if known is not None and known.end + 4 - known.record == length:
            head = self._source.read(begin, known.begin)
            if read_attachment(Cursor(self.path, head, 0, len(head), begin)) == known:
                return
        raise self._damaged(f"an attachment at byte {position} is not in the file's index")

    def _announce_walk(self) -> None:
        if self.size > MAX_WALKED_BYTES:
            raise self._damaged(
                f"it has no index, and {self.size} bytes are too many to be looked through from elsewhere; download it"
            )
        _log.warning("%s has no index: all of its %d bytes are read to find what is in it", self.path, self.size)

    def _take(self, index: Index) -> None:
        head = self._read_record(len(MAGIC), MAX_HEADER_BYTES)
        if head[0] != HEADER:
            raise self._damaged("the file does not begin with a header, or has a second one")
        self._read_header(Cursor(self.path, head, RECORD_HEAD, len(head), len(MAGIC)))
        self._declared = index.declared
        for attachment in sorted(index.attachments, key=lambda a: a.record):
            self._add_attachment(attachment)
        self._data_end, self._data_crc, self.finished = index.data_end, index.data_crc, True
        self._index = index.chunks
        for number, c in enumerate(index.chunks):
            self._chunks.append(c.chunk)
            if not c.channels:
                self._unscanned.append(number)
            for channel in c.channels:
                if channel not in self._declared.topics:
                    raise self._damaged(f"messages of an undeclared channel {channel}")
                self._unlisted.setdefault(channel, []).append(number)

    def _look_for(self, topic: str) -> None:
        # the messages of a topic, where the index does not say them already
        unscanned, self._unscanned = self._unscanned, []
        for number in unscanned:
            self._scan_chunk(number)
        if unscanned and (missing := set(self._messages) - set(self._declared.topics)):
            raise self._damaged(f"messages of an undeclared channel {min(missing)}")
        for channel in self._declared.numbers.get(topic, ()):
            for number in self._unlisted.pop(channel, ()):
                self._list_messages(number, channel)

    def _list_messages(self, number: int, channel: int) -> None:
        # those of one channel of a chunk
        found = self._index[number]
        if self._sole(number):
            self._add(channel, found.first_time, number, 0)
            return
        place = found.place_of(channel)
        record = self._read_record(place, min(found.index_bytes, MAX_INDEX_BYTES))
        check_head(self.path, MESSAGE_INDEX, record, len(record) - RECORD_HEAD)
        if place + len(record) > found.chunk.end + found.index_bytes:
            raise self._damaged(f"an index of messages at byte {place} is longer than its file's says")
        cursor = Cursor(self.path, record, RECORD_HEAD, len(record), place)
        if self._add_index(cursor, number) != channel:
            raise self._damaged(f"the index at byte {place} is of another topic than its file's says")

    def _walk(self) -> None:
        position = len(MAGIC)
        size = self.size
        indexed: set[int] = set()
        summary = Declarations(self.path)  # taken for themselves, as by a reader that begins with the summary
        while position + RECORD_HEAD <= size:
            head = self._source.read(position, position + RECORD_HEAD)
            opcode, length = head[0], int.from_bytes(head[1:], "little")
            begin, end = position + RECORD_HEAD, position + RECORD_HEAD + length
            if end > size or opcode == 0:  # zeros are no record: a crash leaves them where bytes never arrived
                break
            cursor = Cursor(self.path, self._source.read(begin, end), 0, length, begin)
            if (position == len(MAGIC)) != (opcode == HEADER):
                raise self._damaged("the file does not begin with a header, or has a second one")
            if opcode == FOOTER:
                self._end(cursor, begin, end)
                break
            if opcode == HEADER:
                self._read_header(cursor)
            elif opcode in (SCHEMA, CHANNEL):
                if self._data_end is not None:
                    summary.take(opcode, Cursor(self.path, cursor.rest(), 0, length, begin))
                self._declared.take(opcode, cursor)
            elif self._data_end is not None:
                if opcode in _OF_DATA:
                    raise self._damaged("data follow behind the end of the data")
            elif opcode == MESSAGE:
                channel, _, log_time, _ = MESSAGE_HEAD.unpack(cursor.take(MESSAGE_HEAD.size))
                self._add(channel, log_time, -1, position)
            elif opcode == CHUNK:
                self._add_chunk(cursor)
            elif opcode == MESSAGE_INDEX and self._chunks:
                indexed.add(len(self._chunks) - 1)
                self._add_index(cursor, len(self._chunks) - 1)
            elif opcode == ATTACHMENT:
                found = read_attachment(cursor)
                cursor.take(found.end - found.begin + 4)
                self._add_attachment(found)
            elif opcode == DATA_END:
                self._data_end, self._data_crc = position, cursor.u32()
            position = end
        if not self.finished:
            # no CRC covers an index, and what a crash left may lack some: the chunks themselves are asked
            indexed.clear()
            self._forget_index()
        if set(self._messages) - set(self._declared.topics):
            # without a summary the channels may be declared nowhere but inside the chunks
            indexed.clear()
            self._forget_index()
        for number in range(len(self._chunks)):
            if number not in indexed:
                self._scan_chunk(number)
        missing = set(self._messages) - set(self._declared.topics)
        if self.finished and missing:
            raise self._damaged(f"messages of an undeclared channel {min(missing)}")

    def _end(self, cursor: Cursor, begin: int, end: int) -> None:
        summary, offsets, crc = cursor.u64(), cursor.u64(), cursor.u32()
        if self._source.read(end, min(end + len(MAGIC), self.size)) != MAGIC:
            return  # cut short within the last bytes
        if end + len(MAGIC) != self.size:
            raise self._damaged(f"{self.size - end - len(MAGIC)} bytes follow behind the end of the file")
        if self._data_end is None:
            raise self._damaged("the data section does not end")
        if not all(at == 0 or self._data_end < at <= begin for at in (summary, offsets)):
            raise self._damaged("the footer points to no summary")
        if crc and zlib.crc32(self._source.read(summary or begin - RECORD_HEAD, end - 4)) != crc:
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

    def _read_header(self, cursor: Cursor) -> None:
        self._check_profile(cursor.name())
        self.library = cursor.name() if cursor.left else ""

    def _check_profile(self, profile: str) -> None:
        family = FORMAT.partition(".")[0]
        if profile == FORMAT:
            return
        if profile.startswith(f"{family}."):
            raise NotARecording(f"{self.path} has format {profile}, this version reads {FORMAT}: update gpusimbench")
        raise NotARecording(
            f"{self.path} is an MCAP file, but not a recording of a simulator (profile '{profile}', not '{FORMAT}')"
        )

    def _add(self, channel: int, log_time: int, chunk: int, offset: int) -> None:
        self._message_count += 1
        if self._message_count > most_messages(self.size):
            raise self._damaged(f"it announces more than {self._message_count - 1} messages, which is refused")
        self._messages.setdefault(channel, array("Q")).extend((log_time, chunk + 1, offset))

    def _add_index(self, cursor: Cursor, chunk: int) -> int:
        channel, entries = self._entries_of(cursor)
        for log_time, offset in _INDEX_ENTRY.iter_unpack(entries):
            self._add(channel, log_time, chunk, offset)
        return channel

    def _entries_of(self, cursor: Cursor) -> tuple[int, memoryview]:
        channel = cursor.u16()
        entries = cursor.take(cursor.u32())
        if len(entries) % _INDEX_ENTRY.size:
            raise self._damaged("a message index has half an entry")
        return channel, entries

    def _add_chunk(self, cursor: Cursor) -> None:
        chunk, _ = read_chunk(cursor)
        cursor.take(chunk.end - chunk.begin)
        self._chunks.append(chunk)

    def _add_attachment(self, attachment: Attachment) -> None:
        if attachment.name in self._attachments:
            raise self._damaged(f"the attachment {attachment.name} is there twice")
        if len(self._attachments) == MAX_ATTACHMENTS:
            raise self._damaged(f"it has more than the {MAX_ATTACHMENTS} attachments that are read")
        self._attachments[attachment.name] = attachment

    def _scan_chunk(self, number: int) -> None:
        data, _ = self._chunks.open(number)
        position = 0
        while position < len(data):
            cursor = Cursor(self.path, data, position, len(data))
            opcode = cursor.take(1)[0]
            length = cursor.u64()
            begin = cursor.position
            cursor.take(length)
            if opcode in (SCHEMA, CHANNEL):
                self._declared.take(opcode, Cursor(self.path, data, begin, begin + length))
            elif opcode == MESSAGE:
                record = Cursor(self.path, data, begin, begin + length)
                channel, _, log_time, _ = MESSAGE_HEAD.unpack(record.take(MESSAGE_HEAD.size))
                self._add(channel, log_time, number, position)
            position = begin + length
