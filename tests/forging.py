"""A recording that says something else than its run did, with digests and content hash made to fit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from gpusimbench.schemas import topics
from gpusimbench.schemas.digest import ContentDigest, attachment_name, content_hash
from gpusimbench.schemas.messages import enum_values, message_class
from gpusimbench.schemas.provenance import PROVENANCE


def forge(
    source: Path,
    target: Path,
    change: Callable[[dict[str, Any]], None],
    *,
    attachment: str = PROVENANCE,
    end: Callable[[Any], None] = lambda end: None,
    honest: bool = True,
    message: Callable[[str, bytes], bytes] = lambda topic, data: data,
    renamed: Mapping[str, tuple[str, bytes]] = MappingProxyType({}),
) -> Path:
    """Copy a recording with one attachment's JSON changed in place.

    end     changes the end record likewise
    honest  False leaves digests and content hash as they were
    message gives what is written of each message, by topic; only of topics that have one
    renamed what stands in place of other attachments: name and bytes, by the name that they had
    """
    digests: dict[str, str] = {}
    gone: list[str] = []

    def other(record: Any, topic: str) -> Any:
        if isinstance(record, Attachment) and record.name == attachment:
            document = json.loads(record.data)
            change(document)
            record.data = json.dumps(document).encode()
            digests[attachment_name(attachment)] = hashlib.sha256(record.data).hexdigest()
        if isinstance(record, Attachment) and record.name in renamed:
            gone.append(attachment_name(record.name))
            record.name, record.data = renamed[record.name]
            digests[attachment_name(record.name)] = hashlib.sha256(record.data).hexdigest()
        if isinstance(record, Message):
            data = message(topic, record.data)
            if data != record.data:
                alone = ContentDigest()
                alone.message(topic, data)
                digests.update(alone.digests())
            record.data = _ended(data, digests if honest else {}, gone, end) if topic == topics.RUN_END else data
        return record

    return copied(source, target, other, enable_data_crcs=True)


def copied(
    source: Path, target: Path, change: Callable[[Any, str], Any] = lambda record, topic: record, **options: Any
) -> Path:
    """Copy a recording as the official library writes it, record by record.

    change   what stands in place of a record of the library's, given the topic of a message
    options  of the library's writer
    """
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    names: dict[int, str] = {}
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out, **options)
        for record in StreamReader(stream).records:
            made = change(record, names[record.channel_id] if isinstance(record, Message) else "")
            match made:
                case Header():
                    writer.start(made.profile, made.library)
                case Schema() if made.id not in schemas:
                    schemas[made.id] = writer.register_schema(made.name, made.encoding, made.data)
                case Channel() if made.id not in channels:
                    names[made.id] = made.topic
                    channels[made.id] = writer.register_channel(
                        made.topic, made.message_encoding, schemas[made.schema_id], made.metadata
                    )
                case Attachment():
                    writer.add_attachment(made.create_time, made.log_time, made.name, made.media_type, made.data)
                case Metadata():
                    writer.add_metadata(made.name, made.metadata)
                case Message():
                    writer.add_message(
                        channels[made.channel_id], made.log_time, made.data, made.publish_time, made.sequence
                    )
        writer.finish()
    return target


def _ended(data: bytes, digests: dict[str, str], gone: list[str], change: Callable[[Any], None]) -> bytes:
    end: Any = message_class("gsb.v1.RunEnd").FromString(data)
    change(end)
    if digests:
        for name in gone:
            del end.digests[name]
        end.digests.update(digests)
        names = {number: name.removeprefix("RUN_STATUS_") for name, number in enum_values("gsb.v1.RunStatus").items()}
        end.content_hash = content_hash(dict(end.digests), names[end.status].lower(), end.reason)
    return end.SerializeToString(deterministic=True)
