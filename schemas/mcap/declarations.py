"""The schemas and channels that a file declares."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.mcap.records import ChannelRecord, Cursor, Op, Record, Schema, damaged, parse

MAX_DECLARED_BYTES = 64 << 20
"""Of all schemas and channels of a file together, each taken once."""

MAX_CHANNEL_BYTES = 1 << 20
"""Of the record of one channel."""

MAX_DECLARED_TEXTS = 1 << 20
"""Texts in the metadata of all its channels: as objects, a text of a few bytes takes a hundred."""


_REMEMBERED_BYTES = 4 << 10
_REMEMBERED = 4096
"""So many declarations of so many bytes at most are kept beyond their file, so that others need not be parsed."""


class TooMuch(DamagedRecording):
    """A file has more of something than is read of a file."""


class NewDeclarations:
    """Tells the declarations of a file that are new. A record that is repeated costs neither time nor memory."""

    def __init__(self, place: Place) -> None:
        self._place = place
        self._taken: set[tuple[int, str, bytes]] = set()
        self._bytes = self._texts = 0

    def parse(self, record: Record, schema: str = "") -> Schema | ChannelRecord | None:
        """A record of one of the two types; None where it was there before, with a schema of the same name.

        TooMuch where it is more than is read of a file; DamagedRecording where it cannot be read.
        """
        key = record.opcode, schema, bytes(record.content)
        if key in self._taken:
            return None
        size = len(record.content)
        if record.opcode != Op.SCHEMA and size > MAX_CHANNEL_BYTES:
            raise TooMuch(
                f"{self._place}: a channel takes {size} bytes to declare; at most {MAX_CHANNEL_BYTES} are read of one"
            )
        self._bytes += size
        found = self._parse(record)
        self._texts += len(found.metadata) if isinstance(found, ChannelRecord) else 0
        if self._bytes > MAX_DECLARED_BYTES or self._texts > MAX_DECLARED_TEXTS:
            raise TooMuch(
                f"{self._place}: its schemas and channels have more than the {MAX_DECLARED_BYTES} bytes or "
                f"{MAX_DECLARED_TEXTS} texts that are read"
            )
        self._taken.add(key)
        return found

    def _parse(self, record: Record) -> Schema | ChannelRecord:
        if len(record.content) <= _REMEMBERED_BYTES:
            with suppress(DamagedRecording):  # which has to name the file
                return _remembered(record.opcode, bytes(record.content))
        return _parsed(record.opcode, record.cursor(self._place))


@lru_cache(maxsize=_REMEMBERED)
def _remembered(opcode: int, content: bytes) -> Schema | ChannelRecord:
    # files of one version of the recorder declare the same, at the beginning and in the summary
    return _parsed(opcode, Cursor(Path(), memoryview(content), 0, len(content)))


def _parsed(opcode: int, cursor: Cursor) -> Schema | ChannelRecord:
    return parse(Schema, cursor) if opcode == Op.SCHEMA else parse(ChannelRecord, cursor)


@dataclass(frozen=True)
class Channel:
    """A channel: its topic, the name of its message type, and its metadata."""

    topic: str
    message: str
    metadata: dict[str, str]


class Declarations:
    """What a file declares, taken record by record.

    channels  by topic, in order of appearance
    topics    by number of the channel
    numbers   of a topic's channels
    schemas   names of message types by their number
    whole     whether every channel's schema was declared ahead of it
    """

    def __init__(self, place: Place) -> None:
        self._place = place
        self._new = NewDeclarations(place)
        self.channels: dict[str, Channel] = {}
        self.topics: dict[int, str] = {}
        self.numbers: dict[str, list[int]] = {}
        self.schemas: dict[int, str] = {}
        self.whole = True

    def take(self, record: Record) -> None:
        """Add a record of one of the two types; DamagedRecording where it contradicts another, or is too much."""
        schema = int.from_bytes(record.content[2:4], "little")
        found = self._new.parse(record, "" if record.opcode == Op.SCHEMA else self.schemas.get(schema, ""))
        if isinstance(found, Schema):
            if self.schemas.setdefault(found.id, found.name) != found.name:
                raise damaged(self._place, f"schema {found.id} has two names")
        elif found is not None:
            self._declare(found)

    def _declare(self, found: ChannelRecord) -> None:
        if self.topics.setdefault(found.id, found.topic) != found.topic:
            raise damaged(self._place, f"channel {found.id} has two topics")
        self.whole &= found.schema_id == 0 or found.schema_id in self.schemas
        channel = Channel(found.topic, self.schemas.get(found.schema_id, ""), found.metadata)
        if self.channels.setdefault(found.topic, channel) != channel:
            raise damaged(self._place, f"the topic {found.topic} is declared twice, not the same")
        if found.id not in (numbers := self.numbers.setdefault(found.topic, [])):
            numbers.append(found.id)

    def covers(self, other: Declarations) -> bool:
        """Whether everything that the other has is here, and the same."""
        return (
            all(self.schemas.get(number) == name for number, name in other.schemas.items())
            and all(self.topics.get(number) == topic for number, topic in other.topics.items())
            and all(self.channels.get(topic) == channel for topic, channel in other.channels.items())
        )
