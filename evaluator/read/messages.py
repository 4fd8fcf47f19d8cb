"""The messages of a recording, parsed; one that cannot be is named."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from gpusimbench.evaluator.read.columns import Columns, columns
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import message_class

_FREE_BYTES = 64 << 20
_MOST_PER_BYTE = 8
"""Messages of one topic that are parsed may hold _FREE_BYTES, and _MOST_PER_BYTE for each byte of the file."""

MAX_MESSAGE_BYTES = 64 << 20
"""Of a message that is parsed; as an object it may take 40 times as much memory for a moment."""

MAX_MESSAGES = 1 << 20
"""Of a topic whose messages are kept as objects."""

MAX_NOTES = 1 << 16
"""The same of events and of gaps in the data, which are shown."""

MAX_END_BYTES = 1 << 20
"""Of the end record, whose digests are kept as objects."""


class Messages:
    """Reads topics of one container.

    container
    path       of the file, for messages of errors
    """

    def __init__(self, container: Container) -> None:
        self.container = container
        self.path: Place = container.path

    def topics(self, prefix: str) -> Iterator[str]:
        """Topics that begin so, in order of appearance."""
        return (topic for topic in self.container.channels if topic.startswith(prefix))

    def has(self, topic: str) -> bool:
        """Whether the topic is declared."""
        return topic in self.container.channels

    def contents(self, topic: str) -> Iterator[memoryview]:
        """Contents of a topic's messages as they are, in the order in which they were written."""
        return self.container.in_sequence(topic)

    def read(self, topic: str, message: str, most: int = MAX_MESSAGES) -> list[Any]:
        """Messages of a topic, parsed; empty where it is not declared. DamagedRecording where they are more."""
        found: list[Any] = []
        for parsed in self.each(topic, message):
            if len(found) == most:
                raise self.damaged(f"{topic} has more than the {most} messages that are read of it")
            found.append(parsed)
        return found

    def each(self, topic: str, message: str) -> Iterator[Any]:
        """The same one after another, however many."""
        room = _FREE_BYTES + _MOST_PER_BYTE * self.container.size
        parse = message_class(message).FromString
        for content in self.contents(topic) if self.has(topic) else ():
            room -= len(content)
            if room < 0 or len(content) > MAX_MESSAGE_BYTES:
                raise self.damaged(f"{topic} unpacks into more than is read of a file of this size")
            try:
                parsed = parse(bytes(content))
            except Exception as error:  # protobuf's DecodeError differs between its backends
                raise self._unparsed(message, error) from None
            yield parsed

    def columns(self, topic: str, message: str, types: dict[int, tuple[str, str]]) -> Iterator[Columns]:
        """The messages of a topic as columns, some at a time; see evaluator.read.columns."""
        room = _FREE_BYTES + _MOST_PER_BYTE * self.container.size
        parse = partial(self.parse, message)
        for contents in self.container.batches(topic) if self.has(topic) else ():
            sizes = [len(content) for content in contents]
            room -= sum(sizes)
            if room < 0 or max(sizes) > MAX_MESSAGE_BYTES:
                raise self.damaged(f"{topic} unpacks into more than is read of a file of this size")
            yield columns(contents, parse, types)

    def parse(self, message: str, content: memoryview | bytes) -> Any:
        """One message; DamagedRecording where it is none of that type."""
        try:
            return message_class(message).FromString(bytes(content))
        except Exception as error:
            raise self._unparsed(message, error) from None

    def _unparsed(self, message: str, error: Exception) -> DamagedRecording:
        return self.damaged(f"a {message} message cannot be parsed: {error}")

    def damaged(self, what: str) -> DamagedRecording:
        """The error that names the file."""
        return DamagedRecording(f"{self.path}: {what}")

    @property
    def content_bytes(self) -> int:
        """Upper bound of what the messages hold, decompressed."""
        return self.container.content_bytes
