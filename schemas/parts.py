"""The two records of an MCAP file that hold much: where their bytes are, and what is said of them."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from gpusimbench.schemas.cursor import Cursor
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Place

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)
"""Opcodes."""

RECORD_HEAD = 9
"""Opcode and length of a record [byte]."""

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Of a message: channel, sequence, log time, publish time."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk of messages: its bytes, places in the file, and how many they become.

    record      where the record's content begins
    begin, end  of the stored bytes; the record ends with them
    """

    compression: str
    uncompressed_size: int
    record: int
    begin: int
    end: int


@dataclass(frozen=True, slots=True)
class Attachment:
    """An attachment.

    record      where the record's content begins
    begin, end  of its data; four bytes of CRC follow, and the record ends
    """

    name: str
    media_type: str
    record: int
    begin: int
    end: int


def check_head(place: Place, opcode: int, record: memoryview, length: int) -> None:
    """DamagedRecording where a record is not of that type and length [byte, without its head]."""
    if record[0] != opcode or int.from_bytes(record[1:RECORD_HEAD], "little") != length:
        raise DamagedRecording(f"{place}: the file's index points to a record of another type or length")


def read_chunk(cursor: Cursor) -> tuple[Chunk, int]:
    """A chunk and its CRC, zero where it has none, from a record's beginning; its bytes need not be there yet."""
    record = cursor.at
    cursor.take(16)  # first and last log time
    uncompressed_size, crc, compression = cursor.u64(), cursor.u32(), cursor.name()
    stored = cursor.u64()
    return Chunk(compression, uncompressed_size, record, cursor.at, cursor.at + stored), crc


def read_attachment(cursor: Cursor) -> Attachment:
    """An attachment, from a record's beginning; its bytes need not be there yet."""
    record = cursor.at
    cursor.take(16)  # log time and creation time
    name, media_type = cursor.name(), cursor.name()
    size = cursor.u64()
    return Attachment(name, media_type, record, cursor.at, cursor.at + size)
