"""The schemas and channels that a file declares."""

from __future__ import annotations

from dataclasses import dataclass

from schemas.cursor import Cursor
from schemas.errors import DamagedRecording
from schemas.location import Place
from schemas.parts import SCHEMA


@dataclass(frozen=True)
class Channel:
    """A channel: its topic, the name of its message type, and its metadata."""

    topic: str
    message: str
    metadata: dict[str, str]


class Declarations:
    """What a file declares, taken record by record. Numbers have 16 bits, so a repeated record costs no memory.

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

    def take(self, opcode: int, cursor: Cursor) -> None:
        """Add a record of one of the two types; DamagedRecording where it contradicts another."""
        number = cursor.u16()
        if opcode == SCHEMA:
            name = cursor.name()
            if self.schemas.setdefault(number, name) != name:
                raise self._damaged(f"schema {number} has two names")
            return
        schema, topic = cursor.u16(), cursor.name()
        cursor.text()  # message encoding; the format has one
        if self.topics.setdefault(number, topic) != topic:
            raise self._damaged(f"channel {number} has two topics")
        self.whole &= schema == 0 or schema in self.schemas
        channel = Channel(topic, self.schemas.get(schema, ""), cursor.text_map())
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
