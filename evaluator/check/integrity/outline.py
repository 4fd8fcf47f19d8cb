"""What a file's own summary says is in it: for a file elsewhere that is not to be read as a whole."""

from __future__ import annotations

from gpusimbench.evaluator.check.integrity.scan import Scan, Stream
from gpusimbench.schemas import topics
from gpusimbench.schemas.blocks import STATE_HEAD_BYTES, state_header_in
from gpusimbench.schemas.mcap.reader import Container


def outline(container: Container) -> Scan:
    """The same as a scan finds, as far as facts of a recording ask for it.

    A stream's encodings are those of its last block alone; its sequences are not looked at.
    """
    found = Scan(container.size, library=container.library, finished=container.finished)
    for chunk in container.chunks:
        found.compressions[chunk.compression] = found.compressions.get(chunk.compression, 0) + 1
        found.stored += chunk.end - chunk.begin
        found.unpacked += chunk.uncompressed_size
    for topic, channel in container.channels.items():
        stream = Stream(topic, channel.message, bytes=container.stored_bytes(topic))
        found.streams[topic] = stream
        if topics.parse_state(topic) is not None and (messages := container.messages(topic)):
            size, head = container.peek(messages[-1], STATE_HEAD_BYTES)
            header = state_header_in(head, size)
            stream.encodings = set() if header is None else {header.encoding}
    found.attachments = {name: memoryview(container.attachment(name) or b"") for name in container.attachment_names()}
    found.ends = [bytes(content) for content in container.in_sequence(topics.RUN_END)]
    return found
