"""A recording that says something else than its run did, with digests and content hash made to fit."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
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
) -> Path:
    """Copy a recording with one attachment's JSON changed in place.

    end     changes the end record likewise
    honest  False leaves digests and content hash as they were
    message gives what is written of each message, by topic; only of topics that have one
    """
    digests: dict[str, str] = {}
    channels: dict[int, str] = {}
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out, enable_data_crcs=True)
        numbers: dict[int, int] = {0: 0}
        targets: dict[int, int] = {}
        for record in StreamReader(stream, validate_crcs=True).records:
            match record:
                case Header():
                    writer.start(record.profile, record.library)
                case Schema():
                    numbers[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                case Channel():
                    channels[record.id] = record.topic
                    targets[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, numbers[record.schema_id], record.metadata
                    )
                case Attachment():
                    data = record.data
                    if record.name == attachment:
                        document = json.loads(data)
                        change(document)
                        data = json.dumps(document).encode()
                        digests[attachment_name(attachment)] = hashlib.sha256(data).hexdigest()
                    writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, data)
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case Message():
                    topic = channels[record.channel_id]
                    data = message(topic, record.data)
                    if data != record.data:
                        alone = ContentDigest()
                        alone.message(topic, data)
                        digests |= alone.digests()
                    if topic == topics.RUN_END:
                        data = _ended(data, digests if honest else {}, end)
                    writer.add_message(
                        targets[record.channel_id], record.log_time, data, record.publish_time, record.sequence
                    )
        writer.finish()
    return target


def _ended(data: bytes, digests: dict[str, str], change: Callable[[Any], None]) -> bytes:
    end: Any = message_class("gsb.v1.RunEnd").FromString(data)
    change(end)
    if digests:
        end.digests.update(digests)
        names = {number: name.removeprefix("RUN_STATUS_") for name, number in enum_values("gsb.v1.RunStatus").items()}
        end.content_hash = content_hash(dict(end.digests), names[end.status].lower(), end.reason)
    serialised: bytes = end.SerializeToString(deterministic=True)
    return serialised
