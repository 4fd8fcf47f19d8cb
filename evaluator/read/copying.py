"""Everything that a file holds into another one, record by record and in its order."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from gpusimbench.evaluator.read.actions import described_generator
from gpusimbench.schemas import FORMAT, __version__, topics
from gpusimbench.schemas.action_generator import GENERATOR, Generator, read_generator
from gpusimbench.schemas.blocks import raw_action
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap.records import (
    MESSAGE_HEAD,
    Attachment,
    ChannelRecord,
    Header,
    Metadata,
    Op,
    Record,
    Schema,
    parse,
)
from gpusimbench.schemas.mcap.walk import Walk
from gpusimbench.schemas.mcap.writer import McapWriter
from gpusimbench.schemas.messages import widened_schema
from gpusimbench.schemas.source import MappedFile
from gpusimbench.schemas.writing import Target

LIBRARY = f"gpusimbench {__version__}"

Change = Callable[[memoryview], bytes]
"""A StateBlock to what is written in its place."""

_STATE = "gsb.v1.StateBlock"


class Placed(NamedTuple):
    """A record to be copied.

    compression  of the chunk that it is in; empty outside of chunks
    end          byte of the file behind it, or behind its chunk
    """

    record: Record
    compression: str
    end: int


def records_of(path: Path) -> Iterator[Placed]:
    """All whole records of the data section that say something, those of a chunk in its place.

    Chunks and attachments are checked against their CRC. DamagedRecording at the first that cannot be read, after all
    records before it.
    """
    walk = Walk(MappedFile(path))
    for record in walk:
        if record.opcode in (Op.DATA_END, Op.FOOTER):
            return
        if record.opcode == Op.ATTACHMENT:
            walk.attached(record, walk.attachment(record))
        if record.opcode != Op.CHUNK:
            yield Placed(record, "", record.end)
            continue
        head = walk.head(record)
        for inner in walk.inside(record, head):
            yield Placed(inner, head.chunk.compression, record.end)


class Copier:
    """Writes the records of one recording into a new file.

    target       the new file
    source       the recording's path, for messages of errors
    compression  of the new file's chunks
    change       what becomes of blocks of states; everything else is copied byte for byte, but the schema of these
                 blocks, which may be older than what is written into them
    draw         actions of which the source has the generator are written as arrays; it was verified
    """

    def __init__(
        self, target: Target, source: Path, *, compression: str, change: Change | None = None, draw: bool = False
    ) -> None:
        profile = FORMAT if draw else _profile(source)
        self._writer = McapWriter(target.stream, profile=profile, library=LIBRARY, compression=compression)
        self._draw = draw
        self._generators: dict[int, Generator] = {}  # by channel of the source
        self._source = source
        self._change = change
        self._schemas = {0: 0}  # new numbers by old ones; a channel of schema 0 has none
        self._channels: dict[int, tuple[int, str]] = {}

    def add(self, record: Record) -> None:
        """Write a record; times, sequence numbers and names stay, indexes are made anew.

        DamagedRecording where it cannot be read.
        """
        cursor = record.cursor(self._source)
        if record.opcode == Op.MESSAGE:
            self._message(record)
        elif record.opcode == Op.SCHEMA:
            schema = parse(Schema, cursor)
            if schema.id not in self._schemas:
                self._schemas[schema.id] = self._writer.schema(schema.name, schema.encoding, _described(schema))
        elif record.opcode == Op.CHANNEL:
            self._channel(parse(ChannelRecord, cursor))
        elif record.opcode == Op.ATTACHMENT:
            found = Attachment.read(cursor)
            content = bytes(cursor.take(found.end - found.begin))
            self._writer.attachment(
                found.name, found.media_type, content, log_time=found.log_time, create_time=found.create_time
            )
        elif record.opcode == Op.METADATA:
            metadata = parse(Metadata, cursor)
            self._writer.metadata(metadata.name, metadata.metadata)

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._writer.finish()

    def _channel(self, channel: ChannelRecord) -> None:
        if channel.id in self._channels:
            return
        if channel.schema_id not in self._schemas:
            raise DamagedRecording(f"{self._source}: {channel.topic} is of schema {channel.schema_id}, not declared")
        metadata = channel.metadata
        if self._draw and (described := described_generator(channel.topic, metadata)) is not None:
            self._generators[channel.id] = read_generator(described)
            metadata = {name: text for name, text in metadata.items() if name != GENERATOR}
        number = self._writer.channel(
            channel.topic, self._schemas[channel.schema_id], metadata, encoding=channel.message_encoding
        )
        self._channels[channel.id] = number, channel.topic

    def _message(self, record: Record) -> None:
        channel, sequence, log_time, content = record.message(self._source)
        if channel not in self._channels:
            raise DamagedRecording(
                f"{self._source}: a message is of channel {channel}, which is not declared before it"
            )
        number, topic = self._channels[channel]
        data: bytes | memoryview = content
        if self._change is not None and topics.parse_state(topic) is not None:
            data = self._change(content)
        elif (generator := self._generators.get(channel)) is not None:
            data = b"".join(raw_action(content, generator)[1])
        publish_time = MESSAGE_HEAD.unpack_from(record.content)[3]
        self._writer.message(number, data, log_time=log_time, publish_time=publish_time, sequence=sequence)


def _profile(source: Path) -> str:
    record = next(iter(Walk(MappedFile(source))), None)
    return parse(Header, record.cursor(source)).profile if record and record.opcode == Op.HEADER else FORMAT


def _described(record: Schema) -> bytes:
    # also where blocks are copied as they are: a file may have been packed before this rule
    ours = record.name == _STATE and record.encoding == "protobuf"
    return widened_schema(_STATE, record.data) if ours else record.data
