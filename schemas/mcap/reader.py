"""An MCAP file as messages and attachments, also when its end is missing.

A file of this machine is mapped, and its top-level records are walked once: a few hundred bytes of headers. A message
of an uncompressed chunk is a view of the mapping. A file elsewhere is opened through its summary (schemas.mcap.index),
and its parts are read when they are needed; without a summary it is walked, too. Every chunk, every attachment and the
summary is checked against its CRC before its content is used (`Container.peek` tells the exception), and every length
against the bytes that are there.

What a stranger's file can cost is bounded by its size, see docs/strangers.md.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import cached_property
from itertools import groupby
from operator import itemgetter

from gpusimbench.schemas.location import Location, Place
from gpusimbench.schemas.mcap import decompression
from gpusimbench.schemas.mcap.contents import Contents, Message
from gpusimbench.schemas.mcap.crc import second
from gpusimbench.schemas.mcap.declarations import Channel
from gpusimbench.schemas.mcap.records import MESSAGE_HEAD, RECORD_HEAD, Chunk, Op, Record, check_head
from gpusimbench.schemas.mcap.verify import verify
from gpusimbench.schemas.mcap.walk import Walk
from gpusimbench.schemas.source import MappedFile, Source

MAX_ATTACHMENT_BYTES = 1 << 30
"""A larger attachment is refused before it is read."""

_HELD_BYTES = 64 << 20  # of messages that wait for those before them


def open_source(place: Place) -> Source:
    """Open a file; RecordingError where it cannot be read."""
    if isinstance(place, Location):
        from gpusimbench.schemas.remote.file import RemoteFile

        return RemoteFile(place)
    return MappedFile(place)


class Container:
    """The messages and attachments of one file.

    path      of the file
    source    its bytes
    finished  whether the file has its footer; without, it is read up to its last whole record
    indexed   whether it was opened through its summary
    library   that wrote it, by its own word
    """

    def __init__(self, path: Place, source: Source | None = None) -> None:
        self.path = path
        self.source = source or open_source(path)
        self._contents = Contents(path, self.source)
        self._chunks = self._contents.chunks
        self.finished = self._contents.finished
        self.indexed = self._contents.indexed
        self.library = self._contents.library

    @property
    def channels(self) -> dict[str, Channel]:
        """The channels by topic, in order of appearance."""
        return self._contents.declared.channels

    def messages(self, topic: str) -> list[Message]:
        """The messages of a topic, all channels of it, in order of log time."""
        return sorted(self._contents.found(topic), key=lambda m: (m.log_time, m.chunk, m.offset))

    def read(self, message: Message) -> tuple[int, memoryview]:
        """Sequence number and content of a message."""
        sequence, content, _ = self.read_with_crc(message)
        return sequence, content

    def read_with_crc(self, message: Message) -> tuple[int, memoryview, int | None]:
        """The same, and the content's CRC-32 where that of its chunk, which was checked, gives it from fewer bytes."""
        contents = self._contents
        if message.chunk < 0:
            return (*contents.content(message, contents.read_record(message.offset)), None)
        data, crc = self._chunks.open(message.chunk)
        offset = message.offset if not contents.sole(message.chunk) else contents.sole_offset(data)
        sequence, content = contents.content(message, contents.record_in(data, offset))
        before = offset + RECORD_HEAD + MESSAGE_HEAD.size
        if not crc or before + len(content) != len(data) or before > len(content):
            return sequence, content, None
        return sequence, content, second(crc, zlib.crc32(data[:before]), len(content))

    def chunk_bytes(self, message: Message) -> int:
        """Bytes of the chunk that a message is in, decompressed; of the message's head where it is in none."""
        return self._chunks[message.chunk].uncompressed_size if message.chunk >= 0 else RECORD_HEAD

    def stored_bytes(self, topic: str) -> int:
        """Bytes of a topic's messages, at most; messages that the index tells the size of are not read."""
        return sum(
            self._chunks[m.chunk].uncompressed_size - RECORD_HEAD - MESSAGE_HEAD.size
            if m.chunk >= 0 and self._contents.sole(m.chunk)
            else self.peek(m, 0)[0]
            for m in self._contents.found(topic)
        )

    def peek(self, message: Message, size: int) -> tuple[int, memoryview]:
        """How long a message's content is, and its first bytes, at most `size`.

        Of an uncompressed chunk nothing else is read, so that its CRC is not checked yet: what is made of these bytes
        has to be borne out by the message, once it is read.
        """
        if message.chunk >= 0 and not (chunk := self._chunks[message.chunk]).compression:
            begin = min(chunk.begin + message.offset, chunk.end)  # an index may point anywhere
            head = self.source.read(begin, min(begin + RECORD_HEAD + MESSAGE_HEAD.size + size, chunk.end))
            if len(head) >= RECORD_HEAD + MESSAGE_HEAD.size and head[0] == Op.MESSAGE:
                length = int.from_bytes(head[1:RECORD_HEAD], "little") - MESSAGE_HEAD.size
                channel, _, log_time, _ = MESSAGE_HEAD.unpack_from(head, RECORD_HEAD)
                if (channel, log_time) == (message.channel, message.log_time) and length >= 0:
                    return length, head[RECORD_HEAD + MESSAGE_HEAD.size :][:length]
        content = self.read(message)[1]
        return len(content), content[:size]

    def in_sequence(self, topic: str) -> Iterator[memoryview]:
        """Contents of a topic's messages in the order in which they were written; a missing one is damage."""
        for contents in self.batches(topic):
            yield from contents

    def batches(self, topic: str) -> Iterator[list[memoryview]]:
        """The same, those of a chunk together where they lie in it in their order."""
        # Read as they lie, so that each chunk is decompressed once; what comes too early waits, as a copy.
        waiting: dict[int, memoryview] = {}
        expected = held = 0
        for messages in self._as_they_lie(topic):
            ready: list[memoryview] = []
            for sequence, content in messages:
                if sequence == expected and not waiting:
                    ready.append(content)
                    expected += 1
                    continue
                if sequence < expected or sequence in waiting:
                    raise self._contents.damaged(f"message {sequence} of {topic} is there twice")
                if sequence > expected:
                    held += len(content) + MESSAGE_HEAD.size
                    if held > _HELD_BYTES:
                        raise self._contents.damaged(
                            f"message {expected} of {topic} is missing, or far behind those after it"
                        )
                    waiting[sequence] = memoryview(bytes(content))
                    continue
                ready.append(content)
                expected += 1
                while expected in waiting:
                    content = waiting.pop(expected)
                    held -= len(content) + MESSAGE_HEAD.size
                    ready.append(content)
                    expected += 1
            if ready:
                yield ready
        if waiting:
            raise self._contents.damaged(f"message {expected} of {topic} is missing")

    def _as_they_lie(self, topic: str) -> Iterator[list[tuple[int, memoryview]]]:
        # sequence numbers and contents of a topic's messages; a chunk is opened once for all that it holds
        contents = self._contents
        for place, messages in groupby(contents.in_order(topic), key=itemgetter(0)):
            number = place - 1
            if number < 0 or contents.sole(number):
                for _, offset, log_time, channel in messages:
                    yield [self.read(Message(channel, log_time, number, offset))]
                continue
            data, _ = self._chunks.open(number)
            yield contents.messages_in(data, messages)

    def attachment(self, name: str) -> bytes | None:
        """An attachment's bytes, checked against its CRC; None where there is none of that name."""
        found = self._contents.attachments.get(name)
        if found is None:
            return None
        if found.end - found.begin > MAX_ATTACHMENT_BYTES:
            raise self._contents.damaged(
                f"the attachment {name} has more than the {MAX_ATTACHMENT_BYTES} bytes that are read"
            )
        begin = found.record - RECORD_HEAD
        data = self.source.read(begin, found.end + 4)
        record = Record(Op.ATTACHMENT, begin, data[RECORD_HEAD:])
        walk = Walk(self.source)
        if self.indexed:
            check_head(self.path, Op.ATTACHMENT, data, len(record.content))
            if walk.attachment(record) != found:
                raise self._contents.damaged(f"the attachment {name} is not what the file's index says")
        content, _ = walk.attached(record, found)
        return bytes(content)

    def attachment_names(self) -> list[str]:
        """Names of all attachments."""
        return list(self._contents.attachments)

    @property
    def size(self) -> int:
        """The size of the file [byte], as it was when it was opened."""
        return self.source.size

    @property
    def chunks(self) -> tuple[Chunk, ...]:
        """All chunks, in the order of the file."""
        return tuple(self._chunks)

    @cached_property
    def content_bytes(self) -> int:
        """Upper bound of what the messages hold, decompressed: no array of the file can be larger, if not packed."""
        sizes = (
            min(c.uncompressed_size, decompression.limit(c.compression, c.end - c.begin))
            for c in self._chunks
            if c.compression
        )
        return self.size + sum(sizes)

    def verify(self, moved: Callable[[float], None] = lambda _: None) -> None:
        """Check the CRC of the whole data section and of every chunk; DamagedRecording names the first that fails.

        Of a file that was opened through its summary, also that nothing lies beside what the summary says.

        moved  see `schemas.mcap.verify`
        """
        verify(self._contents, moved)

    def verified(self) -> AbstractContextManager[None]:
        """Behind `verify`, while content is read whose digests are held against others: no CRC is computed again."""
        return self._chunks.checked()
