"""Makes shipped recordings smaller: python recordings/repack.py FILE...

Chunks are compressed with zstd at level 19, and message indexes are left out, which every reader that goes through a
file chunk by chunk does without. Messages, attachments and metadata stay as they are and in their order: the content
hash of each file is computed anew and has to be the one that it had. A file that would not be smaller stays as it is.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mcap.writer
import zstandard
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify

_CHUNK_BYTES = 4 << 20
_LEVEL = 19


def repack(path: Path) -> tuple[int, int]:
    """Rewrite one file in its place; returns its size before and after [bytes]."""
    small = path.with_suffix(".small")
    with path.open("rb") as source, small.open("wb") as target:
        _copy(StreamReader(source, validate_crcs=True), Writer(
            target, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD,
            index_types=IndexType.ALL & ~IndexType.MESSAGE, enable_data_crcs=True,
        ))  # fmt: skip
    before, after = open_recording(path), open_recording(small)
    verify(after)
    if before.content_hash != after.content_hash:
        raise SystemExit(f"{path}: another content hash, {after.content_hash}; left as it was, see {small}")
    sizes = path.stat().st_size, small.stat().st_size
    if sizes[1] >= sizes[0]:
        small.unlink()
        return sizes[0], sizes[0]
    small.replace(path)
    return sizes


def _copy(source: StreamReader, target: Writer) -> None:
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    for record in source.records:
        match record:
            case Header():
                target.start(record.profile, record.library)
            case Schema():
                schemas[record.id] = target.register_schema(record.name, record.encoding, record.data)
            case Channel():
                channels[record.id] = target.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                )
            case Message():
                target.add_message(
                    channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
                )
            case Attachment():
                target.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                target.add_metadata(record.name, record.metadata)
    target.finish()


def main() -> None:
    """Rewrite all files that are named."""
    mcap.writer.zstandard.compress = zstandard.ZstdCompressor(level=_LEVEL).compress  # the library has one level
    for name in sys.argv[1:]:
        before, after = repack(Path(name))
        print(f"{before:>10} -> {after:>10}  {name}")


if __name__ == "__main__":
    main()
