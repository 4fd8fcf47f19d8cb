"""The records of an MCAP file in its order, up to where it ends or is damaged: for copies, which need nothing else.

Whoever wants messages by topic, or a recording's meaning, opens a schemas.container.Container.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.schemas import decompression
from gpusimbench.schemas.errors import DamagedRecording

_MAGIC_BYTES = 8
_CHUNK, _ATTACHMENT = 6, 9
_LAST = (0, 2, 15)  # zeros, which a crash may leave; the footer; the end of the data section
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")

KINDS = {3: "schema", 4: "channel", 5: "message", 9: "attachment", 12: "metadata"}
"""Records that carry what a file says, by opcode."""


@dataclass(frozen=True)
class Record:
    """A record of the data section.

    kind         a value of KINDS, or "other"
    content      without its head
    compression  of the chunk that it is in; empty outside of chunks
    end          byte of the file behind it, or behind its chunk
    """

    kind: str
    content: memoryview
    compression: str
    end: int


def read_records(path: Path) -> Iterator[Record]:
    """All whole records of the data section, those of a chunk in its place.

    Chunks and attachments are checked against their CRC. DamagedRecording at the first that cannot be read, after all
    records before it.
    """
    with path.open("rb") as stream:
        data = memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))
    try:
        for opcode, content, end in _split(data, _MAGIC_BYTES):
            if opcode in _LAST:
                return
            yield from _records(opcode, content, end)
    except (ValueError, struct.error) as error:
        raise DamagedRecording(f"{path}: a record is damaged: {error}") from None


def _split(data: memoryview, position: int) -> Iterator[tuple[int, memoryview, int]]:
    # opcode, content and end of each record that is whole
    while position + _HEAD.size <= len(data):
        opcode, size = _HEAD.unpack_from(data, position)
        begin = position + _HEAD.size
        if size > len(data) - begin:
            return
        position = begin + size
        yield opcode, data[begin:position], position


def _records(opcode: int, content: memoryview, end: int) -> Iterator[Record]:
    if opcode == _CHUNK:
        compression, chunk = _chunk(content)
        for inner, part, _ in _split(chunk, 0):
            yield Record(KINDS.get(inner, "other"), part, compression, end)
        return
    if opcode == _ATTACHMENT:
        (crc,) = struct.unpack("<I", content[-4:])
        _check(content[:-4], crc, "an attachment")
    yield Record(KINDS.get(opcode, "other"), content, "", end)


def _chunk(content: memoryview) -> tuple[str, memoryview]:
    _, _, size, crc, name_size = _CHUNK_HEAD.unpack_from(content)
    begin = _CHUNK_HEAD.size + name_size
    (stored,) = struct.unpack_from("<Q", content, begin)
    compression = bytes(content[_CHUNK_HEAD.size : begin]).decode()
    if begin + 8 + stored != len(content):
        raise ValueError("a chunk is not as long as it says")
    chunk = decompression.decompress(compression, content[begin + 8 :], size)
    _check(chunk, crc, "a chunk")
    return compression, chunk


def _check(data: memoryview, crc: int, what: str) -> None:
    if crc and zlib.crc32(data) != crc:  # zero where the writer computed none
        raise ValueError(f"{what} fails its CRC")
