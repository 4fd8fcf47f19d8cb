"""Everything that a file holds into another one, record by record and in its order."""

from __future__ import annotations

import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Metadata, Schema

from gpusimbench.schemas import FORMAT, __version__, topics
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap_writer import McapWriter
from gpusimbench.schemas.messages import widened_schema
from gpusimbench.schemas.records import Record
from gpusimbench.schemas.writing import Target

LIBRARY = f"gpusimbench {__version__}"

Change = Callable[[memoryview], bytes]
"""A StateBlock to what is written in its place."""

_MESSAGE_HEAD = struct.Struct("<HIQQ")
_STATE = "gsb.v1.StateBlock"
_TYPES = {"schema": Schema, "channel": Channel, "attachment": Attachment, "metadata": Metadata}


class Copier:
    """Writes the records of one recording into a new file.

    target       the new file
    source       the recording's path, for messages of errors
    compression  of the new file's chunks
    change       what becomes of blocks of states; everything else is copied byte for byte, but the schema of these
                 blocks, which may be older than what is written into them
    """

    def __init__(self, target: Target, source: Path, *, compression: str, change: Change | None = None) -> None:
        self._writer = McapWriter(target.stream, profile=FORMAT, library=LIBRARY, compression=compression)
        self._source = source
        self._change = change
        self._schemas = {0: 0}  # new numbers by old ones; a channel of schema 0 has none
        self._channels: dict[int, tuple[int, str]] = {}

    def add(self, record: Record) -> None:
        """Write a record; times, sequence numbers and names stay, indexes are made anew.

        DamagedRecording where it is none of its kind.
        """
        try:
            if record.kind == "message":
                self._message(record.content)
            elif record.kind in _TYPES:
                self._other(_TYPES[record.kind].read(ReadDataStream(BytesIO(record.content))))
        except (KeyError, ValueError, struct.error, McapError) as error:
            raise DamagedRecording(f"{self._source}: a {record.kind} record cannot be read: {error!r}") from None

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._writer.finish()

    def _message(self, content: memoryview) -> None:
        channel, sequence, log_time, publish_time = _MESSAGE_HEAD.unpack_from(content)
        number, topic = self._channels[channel]
        data: bytes | memoryview = content[_MESSAGE_HEAD.size :]
        if self._change is not None and topics.parse_state(topic) is not None:
            data = self._change(content[_MESSAGE_HEAD.size :])
        self._writer.message(number, data, log_time=log_time, publish_time=publish_time, sequence=sequence)

    def _other(self, record: Any) -> None:
        match record:
            case Schema() if record.id not in self._schemas:
                self._schemas[record.id] = self._writer.schema(record.name, record.encoding, _described(record))
            case Channel() if record.id not in self._channels:
                number = self._writer.channel(
                    record.topic, self._schemas[record.schema_id], record.metadata, encoding=record.message_encoding
                )
                self._channels[record.id] = number, record.topic
            case Attachment():
                self._writer.attachment(
                    record.name, record.media_type, record.data,
                    log_time=record.log_time, create_time=record.create_time,
                )  # fmt: skip
            case Metadata():
                self._writer.metadata(record.name, record.metadata)


def _described(record: Schema) -> bytes:
    # also where blocks are copied as they are: a file may have been packed before this rule
    ours = record.name == _STATE and record.encoding == "protobuf"
    return widened_schema(_STATE, record.data) if ours else record.data
