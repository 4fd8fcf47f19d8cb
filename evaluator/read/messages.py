"""The messages of a recording, parsed; one that cannot be is named.

A stream such as that of memory has many messages that differ in a few numbers alone. They are decoded together, as
columns of numbers: one of them is parsed by protobuf, and says for all that have the same bytes but for these numbers
what else they hold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.wire import FIXED, VARINT, fields

_FEW = 16
"""Fewer messages than these are parsed one by one, which is faster."""

_SHAPES = 32
"""Shapes of messages of one length that are looked for; what is of none of them is parsed one by one."""

_BITS = {"fixed64": 64, "uint64": 63, "uint32": 28}
"""Of numbers that are decoded here, by their type: with more, a varint may mean another number than its digits say."""

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


@dataclass(frozen=True)
class Columns:
    """Some messages of one type.

    parsed   messages, of which each stands for those of its shape
    which    of these stands for each message, shape [message]
    numbers  by field, shape [message]; what an absent field holds by default
    """

    parsed: list[Any]
    which: NDArray[np.int64]
    numbers: dict[str, NDArray[np.uint64]]


def columns(
    contents: Sequence[memoryview], parse: Callable[[bytes], Any], types: dict[int, tuple[str, str]]
) -> Columns:
    """Read messages; what `parse` raises, where it raises something.

    types  of the fields that become columns, by number: the field's name, and fixed64, uint64 or uint32
    """
    found = Columns(
        [], np.zeros(len(contents), dtype=np.int64),
        {name: np.zeros(len(contents), dtype=np.uint64) for name, _ in types.values()},
    )  # fmt: skip
    by_size = gathered((len(content), place) for place, content in enumerate(contents))
    for size, places in by_size.items():
        left = np.array(places)
        if size and len(places) >= _FEW:
            left = _of_one_size(contents, left, parse, types, found)
        for place in left.tolist():
            _take_alone(contents[place], place, parse, found)
    return found


def _of_one_size(
    contents: Sequence[memoryview], places: NDArray[np.int64], parse: Callable[[bytes], Any],
    types: dict[int, tuple[str, str]], found: Columns,
) -> NDArray[np.int64]:  # fmt: skip
    """Read messages of one length; returns the places of those that are left."""
    data = np.frombuffer(b"".join([contents[place] for place in places.tolist()]), np.uint8)
    data = data.reshape(len(places), -1)
    for _ in range(_SHAPES):
        if not len(places):
            break
        first = data[0].tobytes()
        message = parse(first)
        shape = _shape(first, types)
        if shape is None:
            break
        mask, spans = shape
        same = ((data ^ data[0]) & mask == 0).all(axis=1)
        ours, here = data[same], places[same]
        found.which[here] = len(found.parsed)
        found.parsed.append(message)
        for name, begin, end, varint in spans:
            found.numbers[name][here] = _numbers(ours[:, begin:end], varint)
        data, places = data[~same], places[~same]
    return places


def _shape(
    content: bytes, types: dict[int, tuple[str, str]]
) -> tuple[NDArray[np.uint8], list[tuple[str, int, int, bool]]] | None:
    """Which bits of a message are not its numbers', and where these are: name, begin, end, whether a varint.

    None where a field is there twice, is of another type, or has more digits than are decoded, and where the bytes are
    something that protobuf alone can read.
    """
    mask = np.full(len(content), 0xFF, dtype=np.uint8)
    spans: list[tuple[str, int, int, bool]] = []
    seen: set[int] = set()
    end = 0
    try:
        there = list(fields(memoryview(content)))
    except ValueError:
        return None
    for field in there:
        end += len(field.whole)
        if field.number in seen:
            return None
        seen.add(field.number)
        if field.number not in types:
            continue
        name, kind = types[field.number]
        size = FIXED[1] if kind == "fixed64" else len(field.whole) - 1
        if field.whole[0] != field.number << 3 | (1 if kind == "fixed64" else VARINT):  # a tag of one byte, as usual
            return None
        if kind != "fixed64" and 7 * size > _BITS[kind]:
            return None
        mask[end - size : end] = 0 if kind == "fixed64" else 0x80
        spans.append((name, end - size, end, kind != "fixed64"))
    return mask, spans


def _numbers(data: NDArray[np.uint8], varint: bool) -> NDArray[np.uint64]:
    if not varint:
        return np.ascontiguousarray(data).view("<u8").reshape(-1).astype(np.uint64)
    total = np.zeros(len(data), dtype=np.uint64)
    for place in range(data.shape[1]):
        total |= (data[:, place] & np.uint8(0x7F)).astype(np.uint64) << np.uint64(7 * place)
    return total


def _take_alone(content: memoryview, place: int, parse: Callable[[bytes], Any], found: Columns) -> None:
    message = parse(bytes(content))
    found.which[place] = len(found.parsed)
    found.parsed.append(message)
    for name, column in found.numbers.items():
        column[place] = getattr(message, name) & 0xFFFF_FFFF_FFFF_FFFF  # of a negative number, its two's complement


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
        """Messages of a topic, parsed one after another, however many there are."""
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
        """The messages of a topic as columns, some at a time: those with the same fields are decoded together."""
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
