"""The messages of a recording, parsed; one that cannot be is named."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from schemas.container import Container
from schemas.errors import DamagedRecording
from schemas.messages import message_class


class Messages:
    """Reads topics of one container.

    path  of the file, for messages of errors
    """

    def __init__(self, container: Container) -> None:
        self._container = container
        self.path: Path = container.path

    def topics(self, prefix: str) -> Iterator[str]:
        """Topics that begin so, in order of appearance."""
        return (topic for topic in self._container.channels if topic.startswith(prefix))

    def has(self, topic: str) -> bool:
        """Whether the topic is declared."""
        return topic in self._container.channels

    def contents(self, topic: str) -> Iterator[memoryview]:
        """Contents of a topic's messages as they are, in the order in which they were written."""
        return self._container.in_sequence(topic)

    def read(self, topic: str, message: str) -> list[Any]:
        """Messages of a topic, parsed; empty where it is not declared."""
        return [self.parse(message, content) for content in self.contents(topic)] if self.has(topic) else []

    def parse(self, message: str, content: memoryview) -> Any:
        """One message; DamagedRecording where it is none of that type."""
        try:
            return message_class(message).FromString(bytes(content))
        except Exception as error:  # protobuf's DecodeError differs between its backends
            raise DamagedRecording(f"{self.path}: a {message} message cannot be parsed: {error}") from None

    def damaged(self, what: str) -> DamagedRecording:
        """The error that names the file."""
        return DamagedRecording(f"{self.path}: {what}")

    @property
    def content_bytes(self) -> int:
        """Upper bound of what the messages hold, decompressed."""
        return self._container.content_bytes
