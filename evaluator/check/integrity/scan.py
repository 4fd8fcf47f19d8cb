"""A strict walk over every record of a file: what is wrong with it, and what it holds.

``schemas.mcap.reader`` stops at the first damage, so that no wrong number is handed out. This hands out no numbers, and
goes on behind what is wrong. Both read records by the same code, so the MCAP library, which shares none of it, is the
second opinion (evaluator.check.integrity.examination).
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from gpusimbench.evaluator.check.integrity.message_indexes import MessageIndexes
from gpusimbench.evaluator.check.integrity.problem import Kind, Problems, without_path
from gpusimbench.evaluator.read.actions import described_generator
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import state_header
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap.contents import MAX_ATTACHMENTS, most_messages
from gpusimbench.schemas.mcap.declarations import NewDeclarations, TooMuch
from gpusimbench.schemas.mcap.records import (
    MAGIC,
    AttachmentIndex,
    ChannelRecord,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Op,
    Record,
    Schema,
    parse,
)
from gpusimbench.schemas.mcap.walk import Walk, split
from gpusimbench.schemas.source import Source
from gpusimbench.schemas.text import few

_SHOWN = 3

MAX_METADATA = 1 << 16
"""Records of metadata that are read of a file."""

MAX_SUMMARY_RECORDS = 1 << 20
"""Records behind the data section that are read of a file."""


@dataclass
class Stream:
    """A topic, all channels of it.

    message    name of the message type
    sequences  of its messages, in the order of the file
    in_order   whether that is their own
    bytes      of its messages' contents
    encodings  numbers of the encodings of state blocks
    generated  its channel names a generator, which may draw what the messages do not hold
    """

    topic: str
    message: str
    generated: bool = False
    sequences: array[int] = field(default_factory=lambda: array("I"))
    in_order: bool = True
    bytes: int = 0
    encodings: set[int] = field(default_factory=set)

    @cached_property
    def digested(self) -> bool:
        """Whether the end record has a digest of its messages as they are."""
        return topics.has_digest(self.topic) and not self.generated


@dataclass
class Scan:
    """What the walk found.

    size         of the file [byte]
    profile      of the MCAP header
    library      that wrote the file, by its own word
    streams      by topic
    attachments  by name: content, in place; of two of one name the first
    doubtful     names of attachments that are not what was recorded
    digest       of the messages of all streams that have one (topics.has_digest), as they lie in the file
    ends         contents of the messages on /run/end
    compressions of chunks, with how many chunks have each; "" where they are not compressed
    stored, unpacked  bytes of all chunks in the file, and decompressed
    chunks, attached, metadata  what a summary would have to say of these records, by the byte at which each begins
    schemas, channels  by number, as they are first declared
    summary      records behind the data section
    counts       messages by channel number
    finished     the file ends with a footer and the magic
    """

    size: int
    profile: str = ""
    library: str = ""
    streams: dict[str, Stream] = field(default_factory=dict)
    attachments: dict[str, memoryview] = field(default_factory=dict)
    doubtful: set[str] = field(default_factory=set)
    digest: ContentDigest = field(default_factory=ContentDigest)
    ends: list[bytes] = field(default_factory=list)
    compressions: dict[str, int] = field(default_factory=dict)
    stored: int = 0
    unpacked: int = 0
    chunks: dict[int, ChunkIndex] = field(default_factory=dict)
    attached: dict[int, AttachmentIndex] = field(default_factory=dict)
    metadata: dict[int, MetadataIndex] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    summary: list[Record] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    first_time: int | None = None
    last_time: int = 0
    metadata_records: int = 0
    finished: bool = False

    def close(self) -> None:
        """Keep attachments as copies, and no places of records."""
        self.attachments = {name: memoryview(bytes(data)) for name, data in self.attachments.items()}
        self.summary = []


def scan(source: Source, problems: Problems) -> Scan:
    """Walk over a file."""
    return _Scanner(source, problems).scan()


class _Scanner:
    def __init__(self, source: Source, problems: Problems) -> None:
        self._source = source
        self._place = source.place
        self._problems = problems
        self._found = Scan(source.size)
        self._walk = Walk(source, lambda fault, what: problems.add(Kind[fault], what))
        self._new = NewDeclarations(source.place)
        self._chunk: MessageIndexes | None = None  # that message indexes belong to
        self._messages = 0
        self._contents: dict[str, list[memoryview]] = {}  # by topic, that their digest has not taken yet

    def scan(self) -> Scan:
        """Visit every record, up to where there is more of something than is read."""
        try:
            for record in self._walk:
                if not self._walk.in_data:
                    self._summary(record)
                    continue
                try:
                    self._in_data(record)
                except TooMuch:
                    raise
                except DamagedRecording as error:
                    self._note(error)
            self._close_chunk()
            self._end()
        except DamagedRecording as error:  # there is too much of something, or the file became shorter
            what = without_path(error, self._place)
            self._problems.add(Kind.record, what)
            self._problems.skip(what, *(kind for kind in Kind if kind is not Kind.record))
        for topic, stream in self._found.streams.items():
            self._check_sequence(topic, stream.sequences)
        return self._found

    def _note(self, error: DamagedRecording) -> None:
        # a record that cannot be read
        self._problems.add(Kind.record, without_path(error, self._place))

    def _summary(self, record: Record) -> None:
        if len(self._found.summary) == MAX_SUMMARY_RECORDS:
            raise TooMuch(f"{self._place}: more than {MAX_SUMMARY_RECORDS} records lie behind the data section")
        self._found.summary.append(record)

    def _in_data(self, record: Record) -> None:
        if record.opcode == Op.MESSAGE_INDEX:
            if self._chunk is not None:
                self._chunk.add_index(record, *record.message_index(self._place))
            return
        self._close_chunk()
        if record.opcode == Op.HEADER:
            header = parse(Header, record.cursor(self._place))
            self._found.profile, self._found.library = header.profile, header.library
        elif record.opcode in (Op.SCHEMA, Op.CHANNEL):
            self._declare(record)
        elif record.opcode == Op.MESSAGE:
            self._message(record)
            self._feed()
        elif record.opcode == Op.CHUNK:
            self._visit_chunk(record)
        elif record.opcode == Op.ATTACHMENT:
            self._attachment(record)
        elif record.opcode == Op.METADATA:
            self._metadata(record)
        elif record.opcode == Op.DATA_END:
            self._walk.data_end(record)

    def _declare(self, record: Record) -> None:
        found = self._new.parse(record)
        if isinstance(found, Schema):
            if self._found.schemas.setdefault(found.id, found) != found:
                self._problems.add(Kind.record, f"schema {found.id} is declared in two ways")
        elif found is not None:
            self._declare_channel(found)

    def _declare_channel(self, channel: ChannelRecord) -> None:
        if self._found.channels.setdefault(channel.id, channel) != channel:
            self._problems.add(Kind.record, f"channel {channel.id} is declared in two ways")
            return
        schema = self._found.schemas.get(channel.schema_id)
        if schema is None:
            self._problems.add(Kind.record, f"{channel.topic} is of schema {channel.schema_id}, which is not declared")
        elif (schema.encoding, channel.message_encoding) != ("protobuf", "protobuf"):
            self._problems.add(
                Kind.record,
                f"{channel.topic} has messages in {channel.message_encoding!r} and a schema in {schema.encoding!r}, "
                "not in protobuf",
            )
        generated = described_generator(channel.topic, channel.metadata) is not None
        self._found.streams.setdefault(channel.topic, Stream(channel.topic, schema.name if schema else "", generated))

    def _message(self, record: Record) -> tuple[int, int] | None:
        # channel and time
        number, sequence, log_time, content = record.message(self._place)
        found = self._found
        channel = found.channels.get(number)
        if channel is None:
            self._problems.add(Kind.record, f"a message is of channel {number}, which is not declared before it")
            return None
        topic = channel.topic
        stream = found.streams[topic]
        stream.in_order &= sequence == len(stream.sequences)
        stream.sequences.append(sequence)
        stream.bytes += len(content)
        self._messages += 1
        if self._messages > most_messages(found.size):
            raise TooMuch(
                f"{self._place}: it has more than the {self._messages - 1} messages that are read of a file of its size"
            )
        found.counts[number] = found.counts.get(number, 0) + 1
        found.first_time = log_time if found.first_time is None else min(found.first_time, log_time)
        found.last_time = max(found.last_time, log_time)
        if found.ends and topic != topics.RUN_END:
            self._problems.add(Kind.end, f"a message of {topic} lies behind the end record")
        if topic == topics.RUN_END:
            found.ends.append(bytes(content))
        elif stream.digested:
            self._contents.setdefault(topic, []).append(content)
        elif topics.parse_state(topic) is not None:
            with self._problems.noting(Kind.stream):
                stream.encodings.add(state_header(content).encoding)
        return number, log_time

    def _visit_chunk(self, record: Record) -> None:
        head = self._walk.head(record)
        chunk, stored, found = head.chunk, head.chunk.end - head.chunk.begin, self._found
        found.compressions[chunk.compression] = found.compressions.get(chunk.compression, 0) + 1
        found.stored += stored
        found.unpacked += chunk.uncompressed_size
        entry = ChunkIndex(
            head.first_time, head.last_time, record.begin, record.length, {}, 0, chunk.compression, stored,
            chunk.uncompressed_size,
        )  # fmt: skip
        found.chunks[record.begin] = entry
        data = self._walk.open(record, head, self._held)
        if data is None:
            return
        self._chunk = place = MessageIndexes(entry)
        for inner in self._walk.within(data, record.begin):
            try:
                if inner.opcode != Op.MESSAGE:
                    self._declare(inner)
                elif placed := self._message(inner):
                    place.add_message(*placed, inner.begin)
            except TooMuch:
                self._feed()
                raise
            except DamagedRecording as error:
                self._note(error)
        self._feed()

    def _feed(self) -> None:
        for topic, contents in self._contents.items():
            self._found.digest.messages(topic, contents)
        self._contents.clear()

    def _held(self, data: memoryview) -> str:
        # the topics of a chunk, as far as its bytes still say
        numbers = dict.fromkeys(int.from_bytes(r.content[:2], "little") for r in split(data) if r.opcode == Op.MESSAGE)
        names = [self._found.channels[number].topic for number in numbers if number in self._found.channels]
        return few(names, _SHOWN) if names else "topics that it does not tell"

    def _close_chunk(self) -> None:
        # what it holds is known, and so are the indexes behind it, if it has any
        if self._chunk is not None:
            self._found.chunks[self._chunk.entry.start] = self._chunk.check(self._problems)
        self._chunk = None

    def _attachment(self, record: Record) -> None:
        attachment = self._walk.attachment(record)
        name, found = attachment.name, self._found
        content, good = self._walk.attached(record, attachment)
        if not good:
            found.doubtful.add(name)
        if name in found.attachments:
            self._problems.add(Kind.record, f"the attachment {name} is there twice")
        elif len(found.attachments) == MAX_ATTACHMENTS:
            raise TooMuch(f"{self._place}: it has more than the {MAX_ATTACHMENTS} attachments that are read")
        found.attachments.setdefault(name, content)
        found.attached[record.begin] = AttachmentIndex(
            record.begin, record.length, attachment.log_time, attachment.create_time, len(content), name,
            attachment.media_type,
        )  # fmt: skip

    def _metadata(self, record: Record) -> None:
        self._found.metadata_records += 1
        if self._found.metadata_records > MAX_METADATA:
            raise TooMuch(f"{self._place}: it has more than the {MAX_METADATA} records of metadata that are read")
        name = parse(Metadata, record.cursor(self._place)).name
        self._found.metadata[record.begin] = MetadataIndex(record.begin, record.length, name)

    def _end(self) -> None:
        position, summary = self._walk.end, self._found.summary
        left = self._source.size - position
        if not summary or summary[-1].opcode != Op.FOOTER:
            what = (
                f"{left} bytes behind the last whole record belong to one that was cut short" if left else "no footer"
            )
            self._problems.add(Kind.cut_short, what)
            if self._walk.in_data:
                self._problems.add(Kind.cut_short, "the data section has no end, so its CRC is not there either")
        elif left != len(MAGIC) or self._source.read(position, self._source.size) != MAGIC:
            self._problems.add(
                Kind.cut_short, f"{left} bytes follow the footer, not the {len(MAGIC)} that end an MCAP file"
            )
        else:
            self._found.finished = True

    def _check_sequence(self, topic: str, sequences: array[int]) -> None:
        there = np.unique(np.frombuffer(sequences, np.uint32)) if sequences else np.empty(0, np.uint32)
        if len(there) < len(sequences):
            self._problems.add(Kind.sequence, f"{len(sequences) - len(there)} messages of {topic} are there twice")
        if len(there) and (missing := int(there[-1]) + 1 - len(there)):
            first = int(np.argmax(there != np.arange(len(there)))) if there[-1] != len(there) - 1 else len(there)
            self._problems.add(Kind.sequence, f"{missing} messages of {topic} are missing, the first is {first}")
