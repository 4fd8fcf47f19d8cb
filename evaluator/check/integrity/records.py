"""Records of an MCAP file, one after another, and what small ones say."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from gpusimbench.schemas.errors import DamagedRecording

PRIVATE = 0x80
"""Opcodes from here on belong to applications: readers pass over them."""

KNOWN = frozenset(int(code) for code in Opcode)
"""Opcodes that MCAP has."""

_HEAD = 9
_U64 = struct.Struct("<Q")


class Record(NamedTuple):
    """A record: its type, where it begins, and its content in place."""

    opcode: int
    begin: int
    content: memoryview

    @property
    def length(self) -> int:
        """With opcode and length [byte]."""
        return _HEAD + len(self.content)


def parse(kind: type[Any], content: memoryview) -> Any:
    """A small record of MCAP; DamagedRecording where it cannot be read."""
    try:
        return kind.read(ReadDataStream(io.BytesIO(bytes(content))))
    except Exception as error:  # the library raises whatever its parts raise
        name = kind.__name__
        raise DamagedRecording(f"a {name} record cannot be read: {str(error) or type(error).__name__}") from None


def read_records(data: memoryview, begin: int) -> Iterator[Record]:
    """Records one after another, up to the last whole one."""
    while begin + _HEAD <= len(data):
        length = _U64.unpack_from(data, begin + 1)[0]
        if length > len(data) - begin - _HEAD:
            return
        yield Record(data[begin], begin, data[begin + _HEAD : begin + _HEAD + length])
        begin += _HEAD + length


class AttachmentHead(NamedTuple):
    """What stands in front of an attachment's content, and where that begins."""

    log_time: int
    create_time: int
    name: str
    media_type: str
    data_size: int
    begin: int

    @classmethod
    def read(cls, stream: Any) -> AttachmentHead:
        """From a stream, as the library's own records are."""
        times = stream.read8(), stream.read8()
        return cls(*times, stream.read_prefixed_string(), stream.read_prefixed_string(), stream.read8(), stream.count)
