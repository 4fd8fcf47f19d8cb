"""Where the messages, chunks and attachments of a file are: from its own summary, or from a walk over its records."""

from __future__ import annotations

import logging
import struct
import zlib
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import repeat

from gpusimbench.schemas import FORMAT, PROFILES
from gpusimbench.schemas.errors import DamagedRecording, FailedCrc, NotARecording
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.mcap.chunks import Chunks
from gpusimbench.schemas.mcap.declarations import Declarations
from gpusimbench.schemas.mcap.index import Index, IndexedChunk, read_index
from gpusimbench.schemas.mcap.records import (
    INDEX_ENTRY,
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    WHOLE_MESSAGE_HEAD,
    Attachment,
    Footer,
    Header,
    Op,
    Record,
    parse,
)
from gpusimbench.schemas.mcap.walk import MessageHead, Walk, split
from gpusimbench.schemas.source import Source

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


class Contents:
    """What is where in a file.

    place        of the file
    source       its bytes
    finished     whether the file has its footer; without, it is read up to its last whole record
    library      that wrote it, by its own word
    declared     its schemas and channels
    chunks       in the order of the file
    attachments  by name
    index        what the summary says of the chunks; empty where the file was walked
    data_end     where the record is that ends the data section; None where there is none
    data_crc     what that says; zero where it says nothing
    """

    def __init__(self, place: Place, source: Source) -> None:
        self.place = place
        self.source = source
        if source.size < len(MAGIC) or source.read(0, len(MAGIC)) != MAGIC:
            raise NotARecording(f"{place} is not an MCAP file")
        self.finished = False
        self.library = ""
        self.declared = Declarations(place)
        self.chunks = Chunks(place, source)
        self.attachments: dict[str, Attachment] = {}
        self.data_end: int | None = None
        self.data_crc = 0
        self.index: tuple[IndexedChunk, ...] = ()
        self._messages: dict[int, array[int]] = {}  # by channel: log time, chunk + 1 and offset of each, flat
        self._message_count = 0
        self._unlisted: dict[int, list[int]] = {}  # by channel, chunks whose messages of it were not looked for yet
        self._unscanned: list[int] = []  # chunks that nothing says the messages of
        index = None if source.near else read_index(source)
        self.indexed = index is not None
        if index is not None:
            self._take(index)
        else:
            self._walk()

    def found(self, topic: str) -> Iterator[Message]:
        """The messages of a topic, in no order."""
        self._look_for(topic)
        for number in self.declared.numbers.get(topic, ()):
            yield from self._entries(number)

    def _entries(self, channel: int) -> Iterator[Message]:
        entries = iter(self._messages.get(channel, ()))
        for log_time, chunk, offset in zip(entries, entries, entries, strict=True):
            yield Message(channel, log_time, chunk - 1, offset)

    def in_order(self, topic: str) -> list[tuple[int, int, int, int]]:
        """The messages of a topic as they lie in the file: chunk + 1, offset, log time and channel of each."""
        self._look_for(topic)
        places: list[tuple[int, int, int, int]] = []
        for number in self.declared.numbers.get(topic, ()):
            entries = self._messages.get(number, array("Q"))
            places += zip(entries[1::3], entries[2::3], entries[::3], repeat(number))
        places.sort()
        return places

    def messages_in(
        self, data: memoryview, places: Iterable[tuple[int, int, int, int]]
    ) -> list[tuple[int, memoryview]]:
        """Sequence numbers and contents of messages of one chunk, from its bytes.

        places  of the messages, by the word of an index, as of `in_order`
        """
        found, size, last = [], len(data), len(data) - WHOLE_MESSAGE_HEAD.size
        head_of, head_size, message = WHOLE_MESSAGE_HEAD.unpack_from, MESSAGE_HEAD.size, Op.MESSAGE
        for _, offset, log_time, channel in places:  # millions of them: nothing is looked up in this loop
            if offset > last:
                raise self.damaged("an index points past the end of its chunk")
            opcode, length, number, sequence, time, _ = head_of(data, offset)
            end = offset + RECORD_HEAD + length
            if opcode != message or length < head_size or end > size:
                raise self.damaged("an index points to something that is no message")
            if number != channel or time != log_time:
                raise self.damaged("a message and its index disagree on its topic or its time")
            found.append((sequence, data[offset + WHOLE_MESSAGE_HEAD.size : end]))
        return found

    def record_in(self, data: memoryview, offset: int) -> Record:
        """The record that begins at an offset in a chunk's bytes."""
        begin = offset + RECORD_HEAD
        if begin + MESSAGE_HEAD.size > len(data):
            raise self.damaged("an index points past the end of its chunk")
        end = begin + int.from_bytes(data[offset + 1 : begin], "little")
        if end > len(data):
            raise self.damaged("an index points to something that is no message")
        return Record(data[offset], offset, data[begin:end])

    def content(self, message: Message, record: Record) -> tuple[int, memoryview]:
        """Sequence number and content of a message from its record."""
        if record.opcode != Op.MESSAGE or len(record.content) < MESSAGE_HEAD.size:
            raise self.damaged("an index points to something that is no message")
        channel, sequence, log_time, content = record.message(self.place)
        if (channel, log_time) != (message.channel, message.log_time):
            raise self.damaged("a message and its index disagree on its topic or its time")
        return sequence, content

    def sole(self, chunk: int) -> bool:
        """Whether the index of the file says of a chunk that it holds one message."""
        return bool(self.index) and len(self.index[chunk].channels) == self.index[chunk].messages == 1

    def sole_offset(self, data: memoryview) -> int:
        """Where the only message of a chunk begins, behind what declares its channel; it has to be the last record."""
        for record in split(data):
            if record.opcode not in (Op.SCHEMA, Op.CHANNEL):
                if record.end == len(data):
                    return record.begin
                break
        raise self.damaged("a chunk does not hold the one message that the file's index says")

    def read_record(self, position: int, most: int | None = None) -> Record:
        """A record outside of chunks; of a file elsewhere, one of at most that many bytes."""
        size = self.source.size - position - RECORD_HEAD
        head = self.source.read(position, position + RECORD_HEAD) if size >= 0 else memoryview(b"")
        length = int.from_bytes(head[1:], "little")
        if size < 0 or length > size:
            raise self.damaged("an index points past the end of the file")
        if most is not None and length > most and not self.source.near:
            raise self.damaged(
                f"the record at byte {position} has {length} bytes, more than the {most} that are read from elsewhere"
            )
        begin = position + RECORD_HEAD
        return Record(head[0], position, self.source.read(begin, begin + length))

    def damaged(self, what: str) -> DamagedRecording:
        """The error that names the file."""
        return DamagedRecording(f"{self.place}: {what}")

    # -- from the summary

    def _take(self, index: Index) -> None:
        head = self.read_record(len(MAGIC), MAX_HEADER_BYTES)
        if head.opcode != Op.HEADER:
            raise self.damaged("the file does not begin with a header, or has a second one")
        self._take_header(head)
        self.declared = index.declared
        for attachment in sorted(index.attachments, key=lambda a: a.record):
            self._add_attachment(attachment)
        self.data_end, self.data_crc, self.finished = index.data_end, index.data_crc, True
        self.index = index.chunks
        for number, c in enumerate(index.chunks):
            self.chunks.append(c.chunk)
            if not c.channels:
                self._unscanned.append(number)
            for channel in c.channels:
                if channel not in self.declared.topics:
                    raise self.damaged(f"messages of an undeclared channel {channel}")
                self._unlisted.setdefault(channel, []).append(number)

    def _look_for(self, topic: str) -> None:
        # the messages of a topic, where the index does not say them already
        unscanned, self._unscanned = self._unscanned, []
        for number in unscanned:
            self._scan_chunk(number)
        if unscanned and (missing := self._messages.keys() - self.declared.topics.keys()):
            raise self.damaged(f"messages of an undeclared channel {min(missing)}")
        for channel in self.declared.numbers.get(topic, ()):
            for number in self._unlisted.pop(channel, ()):
                self._list_messages(number, channel)

    def _list_messages(self, number: int, channel: int) -> None:
        # those of one channel of a chunk
        found = self.index[number]
        if self.sole(number):
            self._add(channel, found.first_time, number, 0)
            return
        place = found.place_of(channel)
        record = self.read_record(place, min(found.index_bytes, MAX_INDEX_BYTES))
        if record.opcode != Op.MESSAGE_INDEX:
            raise self.damaged("the file's index points to a record of another type or length")
        if record.end > found.chunk.end + found.index_bytes:
            raise self.damaged(f"an index of messages at byte {place} is longer than its file's says")
        if self._add_index(record, number) != channel:
            raise self.damaged(f"the index at byte {place} is of another topic than its file's says")

    # -- from a walk

    def _walk(self) -> None:
        if not self.source.near:
            self._announce_walk()
        walk = Walk(self.source)
        indexed: set[int] = set()
        summary = Declarations(self.place)  # taken for themselves, as by a reader that begins with the summary
        for record in walk:
            opcode = record.opcode
            if opcode == Op.HEADER:
                self._take_header(record)
            elif opcode in (Op.SCHEMA, Op.CHANNEL):
                if not walk.in_data:
                    summary.take(record)
                self.declared.take(record)
            elif opcode == Op.MESSAGE:
                channel, _, log_time, _ = record.message(self.place)
                self._add(channel, log_time, -1, record.begin)
            elif opcode == Op.CHUNK:
                self.chunks.append(walk.head(record).chunk)
            elif opcode == Op.MESSAGE_INDEX and self.chunks:
                indexed.add(len(self.chunks) - 1)
                self._add_index(record, len(self.chunks) - 1)
            elif opcode == Op.ATTACHMENT:
                self._add_attachment(walk.attachment(record))
            elif opcode == Op.DATA_END:
                self.data_end, self.data_crc = record.begin, walk.data_end(record)
            elif opcode == Op.FOOTER:
                self._end(record)
        if not self.finished or self._messages.keys() - self.declared.topics.keys():
            # No CRC covers an index, and what a crash left may lack some; without a summary, channels may be declared
            # nowhere but inside the chunks. So the chunks themselves are asked.
            indexed.clear()
            self._forget_index()
        for number in range(len(self.chunks)):
            if number not in indexed:
                self._scan_chunk(number)
        missing = self._messages.keys() - self.declared.topics.keys()
        if self.finished and missing:
            raise self.damaged(f"messages of an undeclared channel {min(missing)}")

    def _announce_walk(self) -> None:
        size = self.source.size
        if size > MAX_WALKED_BYTES:
            raise self.damaged(
                f"it has no index, and {size} bytes are too many to be looked through from elsewhere; download it"
            )
        _log.warning("%s has no index: all of its %d bytes are read to find what is in it", self.place, size)

    def _end(self, record: Record) -> None:
        footer, size = parse(Footer, record.cursor(self.place)), self.source.size
        if self.source.read(record.end, min(record.end + len(MAGIC), size)) != MAGIC:
            return  # cut short within the last bytes
        if record.end + len(MAGIC) != size:
            raise self.damaged(f"{size - record.end - len(MAGIC)} bytes follow behind the end of the file")
        if self.data_end is None:
            raise self.damaged("the data section does not end")
        content = record.begin + RECORD_HEAD
        if not all(at == 0 or self.data_end < at <= content for at in (footer.summary_start, footer.offsets_start)):
            raise self.damaged("the footer points to no summary")
        summary = self.source.read(footer.summary_start or record.begin, record.end - 4)
        if footer.summary_crc and zlib.crc32(summary) != footer.summary_crc:
            raise FailedCrc(f"{self.place}: the summary fails its CRC")
        self.finished = True

    def _forget_index(self) -> None:
        outside = {number: [m for m in self._entries(number) if m.chunk < 0] for number in self._messages}
        self._messages, self._message_count = {}, 0
        for number, messages in outside.items():
            for m in messages:
                self._add(number, m.log_time, -1, m.offset)

    def _scan_chunk(self, number: int) -> None:
        data, _ = self.chunks.open(number)
        heads: list[MessageHead] = []
        for record in Walk(self.source).within(data, self.chunks[number].at, heads):
            if record.opcode == Op.MESSAGE:
                record.message(self.place)  # too short, or it were among the heads
            else:
                self.declared.take(record)
        self._count(len(heads))
        for channel, offset, _, log_time in heads:
            self._messages.setdefault(channel, array("Q")).extend((log_time, number + 1, offset))

    # -- from either

    def _take_header(self, record: Record) -> None:
        header = parse(Header, record.cursor(self.place))
        if header.profile not in PROFILES and header.profile.startswith(f"{FORMAT.partition('.')[0]}."):
            raise NotARecording(
                f"{self.place} has format {header.profile}, this version reads {' and '.join(PROFILES)}: "
                "update gpusimbench"
            )
        if header.profile not in PROFILES:
            raise NotARecording(
                f"{self.place} is an MCAP file, but not a recording of a simulator (profile '{header.profile}', not "
                f"'{FORMAT}')"
            )
        self.library = header.library

    def _count(self, messages: int) -> None:
        self._message_count += messages
        if self._message_count > (most := most_messages(self.source.size)):
            raise self.damaged(f"it announces more than {most} messages, which is refused")

    def _add(self, channel: int, log_time: int, chunk: int, offset: int) -> None:
        self._count(1)
        self._messages.setdefault(channel, array("Q")).extend((log_time, chunk + 1, offset))

    def _add_index(self, record: Record, chunk: int) -> int:
        channel, entries = record.message_index(self.place)
        count = len(entries) // INDEX_ENTRY.size
        self._count(count)
        if count:
            values = array("Q", struct.unpack(f"<{2 * count}Q", entries))
            flat = array("Q", [chunk + 1]) * (3 * count)
            flat[::3], flat[2::3] = values[::2], values[1::2]
            self._messages.setdefault(channel, array("Q")).extend(flat)
        return channel

    def _add_attachment(self, attachment: Attachment) -> None:
        if attachment.name in self.attachments:
            raise self.damaged(f"the attachment {attachment.name} is there twice")
        if len(self.attachments) == MAX_ATTACHMENTS:
            raise self.damaged(f"it has more than the {MAX_ATTACHMENTS} attachments that are read")
        self.attachments[attachment.name] = attachment
