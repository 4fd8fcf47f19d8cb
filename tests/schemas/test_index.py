"""What the summary of a file says of its chunks, against what lies in them."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer

from gpusimbench.schemas.mcap.index import read_index
from gpusimbench.schemas.mcap.reader import open_source


@pytest.mark.parametrize(("channels", "messages"), [(1, 1), (1, 5), (16, 1), (16, 3), (40, 2)])
def test_messages_of_a_chunk_are_counted_by_its_indexes(channels: int, messages: int, tmp_path: Path) -> None:
    """Count as many messages as were written, however many channels share the chunk."""
    path = tmp_path / "many.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        numbers = [writer.register_channel(f"/{n}", "json", 0) for n in range(channels)]
        for time in range(messages):
            for number in numbers:
                writer.add_message(number, time, b"{}", time)
        writer.finish()
    index = read_index(open_source(path))
    assert index is not None
    (chunk,) = index.chunks
    assert chunk.messages == channels * messages
    assert list(chunk.channels) == numbers
    assert (chunk.first_time, chunk.last_time) == (0, messages - 1)
