"""A walk over every record of a file that goes on behind what is wrong.

``schemas.container`` stops at the first damage, so that no wrong number is handed out. This walk hands out no numbers:
it notes each problem, and what the file holds. It shares no code with the container, so each checks the other.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap import records
from mcap.opcode import Opcode

from gpusimbench.evaluator.check.integrity.chunk_place import ChunkPlace
from gpusimbench.evaluator.check.integrity.problem import Kind, Problems
from gpusimbench.evaluator.check.integrity.records import KNOWN, PRIVATE, AttachmentHead, Record, parse, read_records
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import state_header
from gpusimbench.schemas.container import MAX_ATTACHMENTS, most_messages
from gpusimbench.schemas.declarations import MAX_CHANNEL_BYTES, MAX_DECLARED_BYTES, MAX_DECLARED_TEXTS
from gpusimbench.schemas.decompression import decompress
from gpusimbench.schemas.digest import ContentDigest
from gpusimbench.schemas.errors import DamagedRecording, NotARecording
from gpusimbench.schemas.mcap_writer import MAGIC

_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")
_SHOWN = 3

MAX_METADATA = 1 << 16
"""Records of metadata that are read of a file."""

MAX_SUMMARY_RECORDS = 1 << 20
"""Records behind the data section that are read of a file."""


class _TooMuch(Exception):
    """There is more of something than is read of a file; the walk ends."""


@dataclass
class Stream:
    """A topic, all channels of it.

    message    name of the message type
    sequences  of its messages, in the order of the file
    in_order   whether that is their own
    bytes      of its messages' contents
    encodings  numbers of the encodings of state blocks
    """

    topic: str
    message: str
    sequences: array[int] = field(default_factory=lambda: array("I"))
    in_order: bool = True
    bytes: int = 0
    encodings: set[int] = field(default_factory=set)


@dataclass
class Scan:
    """What the walk found.

    data         the file; empty once it was closed
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
    expected     what a summary would have to say, by the type of its records
    schemas, channels  by number, as they are first declared
    summary      records behind the data section
    counts       messages by channel number
    finished     the file ends with a footer and the magic
    """

    data: memoryview
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
    expected: dict[Opcode, list[Any]] = field(default_factory=dict)
    schemas: dict[int, Any] = field(default_factory=dict)
    channels: dict[int, Any] = field(default_factory=dict)
    summary: list[Record] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    first_time: int | None = None
    last_time: int = 0
    metadata_records: int = 0
    finished: bool = False

    def close(self) -> None:
        """Give the file back; attachments are kept, places of records are not."""
        self.attachments = {name: memoryview(bytes(data)) for name, data in self.attachments.items()}
        self.summary = []
        self.data = memoryview(b"")


def scan(path: Path, problems: Problems) -> Scan:
    """Walk over a file. NotARecording where it is no MCAP file."""
    if path.exists() and not path.is_file():
        raise NotARecording(f"{path} is not a file")
    try:
        with path.open("rb") as stream:
            data = memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))
    except OSError as error:
        raise NotARecording(f"cannot read {path}: {error.strerror}") from None
    except ValueError:  # an empty file cannot be mapped
        raise NotARecording(f"{path} is not an MCAP file: it is empty") from None
    if data[: len(MAGIC)] != MAGIC:
        raise NotARecording(f"{path} is not an MCAP file")
    return _Walk(data, problems).walk()


class _Walk:
    def __init__(self, data: memoryview, problems: Problems) -> None:
        self._data = data
        self._problems = problems
        self._found = Scan(data, len(data))
        self._place: ChunkPlace | None = None  # the chunk that message indexes belong to
        self._messages = 0
        self._declared: set[tuple[int, bytes]] = set()  # records of schemas and channels
        self._declared_bytes = self._declared_texts = 0

    def walk(self) -> Scan:
        """Visit every record, up to where there is more of something than is read."""
        try:
            self._visit()
        except _TooMuch as error:
            self._problems.add(Kind.record, str(error))
            self._problems.skip(str(error), *(kind for kind in Kind if kind is not Kind.record))
        for topic, stream in self._found.streams.items():
            self._check_sequence(topic, stream.sequences)
        return self._found

    def _visit(self) -> None:
        position, in_data = len(MAGIC), True
        for record in read_records(self._data, position):
            if record.begin == len(MAGIC) and record.opcode != Opcode.HEADER:
                self._problems.add(Kind.record, "the first record is no header")
            if record.opcode not in KNOWN:
                self._unknown(record, f"byte {record.begin}")
            elif in_data:
                with self._problems.noting(Kind.record):
                    self._in_data(record)
                in_data = record.opcode not in (Opcode.DATA_END, Opcode.FOOTER)
            elif len(self._found.summary) == MAX_SUMMARY_RECORDS:
                raise _TooMuch(f"more than {MAX_SUMMARY_RECORDS} records lie behind the data section")
            else:
                self._found.summary.append(record)
            position = record.begin + record.length
            if record.opcode == Opcode.FOOTER:
                break
        self._close_chunk()
        self._end(position, in_data)

    def _in_data(self, record: Record) -> None:
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._close_chunk()
        match record.opcode:
            case Opcode.HEADER:
                if record.begin != len(MAGIC):
                    self._problems.add(Kind.record, f"there is a second header at byte {record.begin}")
                    return
                header = parse(records.Header, record.content)
                self._found.profile, self._found.library = header.profile, header.library
            case Opcode.SCHEMA | Opcode.CHANNEL:
                self._declare(record)
            case Opcode.MESSAGE:
                self._message(record)
            case Opcode.CHUNK:
                self._chunk(record)
            case Opcode.MESSAGE_INDEX:
                if self._place is not None:
                    self._place.add_index(record)
            case Opcode.ATTACHMENT:
                self._attachment(record)
            case Opcode.METADATA:
                self._metadata(record)
            case Opcode.DATA_END:
                self._data_end(record)
            case _:
                self._problems.add(
                    Kind.record, f"a record of the summary, type {record.opcode}, lies before the data section's end"
                )

    def _unknown(self, record: Record, where: str) -> None:
        if record.opcode < PRIVATE:
            self._problems.add(
                Kind.unknown_record, f"a record of type {record.opcode:#04x} at {where}, {len(record.content)} bytes"
            )

    def _declare(self, record: Record) -> None:
        content = bytes(record.content)
        if (record.opcode, content) in self._declared:
            return
        if record.opcode == Opcode.CHANNEL and len(content) > MAX_CHANNEL_BYTES:
            raise _TooMuch(f"a channel takes {len(content)} bytes to declare, more than the {MAX_CHANNEL_BYTES} read")
        self._declared.add((record.opcode, content))
        self._declared_bytes += len(content)
        self._declared_texts += self._declare_new(record)
        if self._declared_bytes > MAX_DECLARED_BYTES or self._declared_texts > MAX_DECLARED_TEXTS:
            raise _TooMuch(
                f"its schemas and channels have more than the {MAX_DECLARED_BYTES} bytes or {MAX_DECLARED_TEXTS} texts "
                "that are read"
            )

    def _declare_new(self, record: Record) -> int:
        # texts of its metadata
        if record.opcode == Opcode.SCHEMA:
            schema = parse(records.Schema, record.content)
            if self._found.schemas.setdefault(schema.id, schema) != schema:
                self._problems.add(Kind.record, f"schema {schema.id} is declared in two ways")
            return 0
        channel = parse(records.Channel, record.content)
        if self._found.channels.setdefault(channel.id, channel) != channel:
            self._problems.add(Kind.record, f"channel {channel.id} is declared in two ways")
            return 0
        schema = self._found.schemas.get(channel.schema_id)
        if schema is None:
            self._problems.add(Kind.record, f"{channel.topic} is of schema {channel.schema_id}, which is not declared")
        elif (schema.encoding, channel.message_encoding) != ("protobuf", "protobuf"):
            self._problems.add(
                Kind.record,
                f"{channel.topic} has messages in {channel.message_encoding!r} and a schema in {schema.encoding!r}, "
                "not in protobuf",
            )
        self._found.streams.setdefault(channel.topic, Stream(channel.topic, schema.name if schema else ""))
        return len(channel.metadata)

    def _message(self, record: Record) -> tuple[int, int] | None:
        # channel and time
        if len(record.content) < _MESSAGE.size:
            raise DamagedRecording(f"a message at byte {record.begin} is shorter than its own head")
        number, sequence, log_time, _ = _MESSAGE.unpack_from(record.content)
        channel = self._found.channels.get(number)
        if channel is None:
            self._problems.add(Kind.record, f"a message is of channel {number}, which is not declared before it")
            return None
        content = record.content[_MESSAGE.size :]
        stream = self._found.streams[channel.topic]
        stream.in_order &= sequence == len(stream.sequences)
        stream.sequences.append(sequence)
        stream.bytes += len(content)
        self._messages += 1
        if self._messages > most_messages(self._found.size):
            raise _TooMuch(f"it has more than the {self._messages - 1} messages that are read of a file of its size")
        found = self._found
        found.counts[number] = found.counts.get(number, 0) + 1
        found.first_time = log_time if found.first_time is None else min(found.first_time, log_time)
        found.last_time = max(found.last_time, log_time)
        if found.ends and channel.topic != topics.RUN_END:
            self._problems.add(Kind.end, f"a message of {channel.topic} lies behind the end record")
        if channel.topic == topics.RUN_END:
            found.ends.append(bytes(content))
        elif topics.has_digest(channel.topic):
            found.digest.message(channel.topic, content)
        elif topics.parse_state(channel.topic) is not None:
            with self._problems.noting(Kind.stream):
                stream.encodings.add(state_header(content).encoding)
        return number, log_time

    def _chunk(self, record: Record) -> None:
        content = record.content
        try:
            first, last, size, crc = _CHUNK.unpack_from(content)
            name_end = _CHUNK.size + 4 + _U32.unpack_from(content, _CHUNK.size)[0]
            compression = str(content[_CHUNK.size + 4 : name_end], "utf-8")
            stored = content[name_end + 8 :]
            if _U64.unpack_from(content, name_end)[0] != len(stored):
                raise DamagedRecording(f"a chunk at byte {record.begin} holds another number of bytes than it says")
        except (struct.error, UnicodeDecodeError):
            raise DamagedRecording(f"a chunk at byte {record.begin} is shorter than its own head") from None
        found = self._found
        found.compressions[compression] = found.compressions.get(compression, 0) + 1
        found.stored += len(stored)
        found.unpacked += size
        entry = records.ChunkIndex(
            chunk_length=record.length,
            chunk_start_offset=record.begin,
            compression=compression,
            compressed_size=len(stored),
            message_end_time=last,
            message_index_length=0,
            message_index_offsets={},
            message_start_time=first,
            uncompressed_size=size,
        )
        found.expected.setdefault(Opcode.CHUNK_INDEX, []).append(entry)
        try:
            data = decompress(compression, stored, size)
        except ValueError as error:
            self._problems.add(Kind.chunk_crc, f"the chunk at byte {record.begin} is lost: {error}")
            return
        if not crc:
            self._problems.add(Kind.crc_missing, "chunks have no CRC")
        elif zlib.crc32(data) != crc:
            self._problems.add(
                Kind.chunk_crc,
                f"the chunk at byte {record.begin}, {len(stored)} bytes, fails its CRC; it is of {self._held(data)}",
            )
        self._place = ChunkPlace(entry)
        self._inside(data, record.begin, self._place)

    def _held(self, data: memoryview) -> str:
        # the topics of a chunk, as far as its bytes still say
        numbers = dict.fromkeys(
            int.from_bytes(record.content[:2], "little")
            for record in read_records(data, 0)
            if record.opcode == Opcode.MESSAGE
        )
        names = [self._found.channels[number].topic for number in numbers if number in self._found.channels]
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        return ", ".join(names[:_SHOWN]) + more if names else "topics that it does not tell"

    def _inside(self, data: memoryview, chunk: int, place: ChunkPlace) -> None:
        position = 0
        for record in read_records(data, 0):
            position = record.begin + record.length
            if record.opcode not in KNOWN:
                self._unknown(record, f"byte {record.begin} of the chunk at byte {chunk}")
            elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                with self._problems.noting(Kind.record):
                    self._declare(record)
            elif record.opcode == Opcode.MESSAGE:
                with self._problems.noting(Kind.record):
                    if placed := self._message(record):
                        place.add_message(*placed, record.begin)
            else:
                self._problems.add(Kind.record, f"the chunk at byte {chunk} holds a record of type {record.opcode}")
        if position != len(data):
            self._problems.add(Kind.record, f"the chunk at byte {chunk} ends within a record")

    def _close_chunk(self) -> None:
        # what it holds is known, and so are the indexes behind it, if it has any
        if self._place is not None:
            self._place.check(self._problems)
        self._place = None

    def _attachment(self, record: Record) -> None:
        content = record.content
        head = parse(AttachmentHead, content)
        begin = head.begin
        stored = content[begin:-4]
        if len(content) < begin + 4 or head.data_size != len(stored):
            raise DamagedRecording(f"the attachment {head.name} holds another number of bytes than it says")
        crc = _U32.unpack_from(content, len(content) - 4)[0]
        if not crc:
            self._problems.add(Kind.crc_missing, f"the attachment {head.name} has no CRC")
        elif zlib.crc32(content[:-4]) != crc:
            self._problems.add(Kind.attachment_crc, f"the attachment {head.name} fails its CRC")
            self._found.doubtful.add(head.name)
        if head.name in self._found.attachments:
            self._problems.add(Kind.record, f"the attachment {head.name} is there twice")
        if len(self._found.attachments) == MAX_ATTACHMENTS and head.name not in self._found.attachments:
            raise _TooMuch(f"it has more than the {MAX_ATTACHMENTS} attachments that are read")
        self._found.attachments.setdefault(head.name, stored)
        self._found.expected.setdefault(Opcode.ATTACHMENT_INDEX, []).append(
            records.AttachmentIndex(
                offset=record.begin,
                length=record.length,
                log_time=head.log_time,
                create_time=head.create_time,
                data_size=head.data_size,
                name=head.name,
                media_type=head.media_type,
            )  # fmt: skip
        )

    def _metadata(self, record: Record) -> None:
        self._found.metadata_records += 1
        if self._found.metadata_records > MAX_METADATA:
            raise _TooMuch(f"it has more than the {MAX_METADATA} records of metadata that are read")
        metadata = parse(records.Metadata, record.content)
        self._found.expected.setdefault(Opcode.METADATA_INDEX, []).append(
            records.MetadataIndex(offset=record.begin, length=record.length, name=metadata.name)
        )

    def _data_end(self, record: Record) -> None:
        crc = parse(records.DataEnd, record.content).data_section_crc
        if not crc:
            self._problems.add(Kind.crc_missing, "the data section has no CRC")
        elif zlib.crc32(self._data[: record.begin]) != crc:
            self._problems.add(Kind.data_crc, "bytes between the file's begin and the data section's end were changed")

    def _end(self, position: int, in_data: bool) -> None:
        left = len(self._data) - position
        ended = bool(self._found.summary) and self._found.summary[-1].opcode == Opcode.FOOTER
        if not ended:
            what = (
                f"{left} bytes behind the last whole record belong to one that was cut short" if left else "no footer"
            )
            self._problems.add(Kind.cut_short, what)
            if in_data:
                self._problems.add(Kind.cut_short, "the data section has no end, so its CRC is not there either")
        elif self._data[position:] != MAGIC:
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
