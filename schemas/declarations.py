"""The schemas and channels that a file declares."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.schemas.cursor import Cursor
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.parts import SCHEMA

MAX_DECLARED_BYTES = 64 << 20
"""Of all schemas and channels of a file together, each taken once."""

MAX_CHANNEL_BYTES = 1 << 20
"""Of the record of one channel."""

MAX_DECLARED_TEXTS = 1 << 20
"""Texts in the metadata of all its channels: as objects, a text of a few bytes takes a hundred."""


@dataclass(frozen=True)
class Channel:
    """A channel: its topic, the name of its message type, and its metadata."""

    topic: str
    message: str
    metadata: dict[str, str]


class Declarations:
    """What a file declares, taken record by record. A record that is repeated costs neither time nor memory.

    channels  by topic, in order of appearance
    topics    by number of the channel
    numbers   of a topic's channels
    schemas   names of message types by their number
    whole     whether every channel's schema was declared ahead of it
    """

    def __init__(self, place: Place) -> None:
        self._place = place
        self.channels: dict[str, Channel] = {}
        self.topics: dict[int, str] = {}
        self.numbers: dict[str, list[int]] = {}
        self.schemas: dict[int, str] = {}
        self.whole = True
        self._taken: set[tuple[int, int, str, bytes]] = set()
        self._bytes = self._texts = 0

    def take(self, opcode: int, cursor: Cursor) -> None:
        """Add a record of one of the two types; DamagedRecording where it contradicts another."""
        number, content = cursor.u16(), bytes(cursor.rest())
        of = "" if opcode == SCHEMA else self.schemas.get(int.from_bytes(content[:2], "little"), "")
        record = opcode, number, of, content
        if record in self._taken:
            return
        if opcode != SCHEMA and len(content) > MAX_CHANNEL_BYTES:
            raise self._damaged(
                f"a channel takes {len(content)} bytes to declare; at most {MAX_CHANNEL_BYTES} are read of one"
            )
        self._bytes += len(content)
        if self._bytes > MAX_DECLARED_BYTES:
            raise self._damaged(f"its schemas and channels have more than the {MAX_DECLARED_BYTES} bytes that are read")
        self._declare(opcode, number, cursor)
        self._taken.add(record)

    def _declare(self, opcode: int, number: int, cursor: Cursor) -> None:
        if opcode == SCHEMA:
            name = cursor.name()
            cursor.text()  # encoding
            cursor.take(cursor.u32())  # the definition; a reader that takes it would run on where it is not there
            if self.schemas.setdefault(number, name) != name:
                raise self._damaged(f"schema {number} has two names")
            return
        schema, topic = cursor.u16(), cursor.name()
        cursor.text()  # message encoding; the format has one
        if self.topics.setdefault(number, topic) != topic:
            raise self._damaged(f"channel {number} has two topics")
        self.whole &= schema == 0 or schema in self.schemas
        channel = Channel(topic, self.schemas.get(schema, ""), cursor.text_map(MAX_DECLARED_TEXTS - self._texts))
        self._texts += len(channel.metadata)
        if self.channels.setdefault(topic, channel) != channel:
            raise self._damaged(f"the topic {topic} is declared twice, not the same")
        if number not in (numbers := self.numbers.setdefault(topic, [])):
            numbers.append(number)

    def covers(self, other: Declarations) -> bool:
        """Whether everything that the other has is here, and the same."""
        return (
            all(self.schemas.get(number) == name for number, name in other.schemas.items())
            and all(self.topics.get(number) == topic for number, topic in other.topics.items())
            and all(self.channels.get(topic) == channel for topic, channel in other.channels.items())
        )

    def _damaged(self, what: str) -> DamagedRecording:
        return DamagedRecording(f"{self._place}: {what}")
