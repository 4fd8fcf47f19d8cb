"""What the summary of a file says of its chunks, against what lies in them."""

from __future__ import annotations

import struct
from pathlib import Path

import fsspec
import pytest
from mcap.writer import CompressionType, Writer

from gpusimbench.schemas import FORMAT
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.location import Location
from gpusimbench.schemas.mcap.index import read_index
from gpusimbench.schemas.mcap.reader import Container, open_source
from gpusimbench.schemas.mcap.records import RECORD_HEAD, Op


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
    (chunk,) = index.chunks
    assert chunk.messages == channels * messages
    assert list(chunk.channels) == numbers
    assert (chunk.first_time, chunk.last_time) == (0, messages - 1)


def test_no_record_lies_upon_another(tmp_path: Path) -> None:
    """Refuse a summary that places an attachment at any byte of a chunk, or of what lists the chunk's messages."""
    path = tmp_path / "one.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, enable_crcs=False)
        writer.start()
        writer.add_attachment(0, 0, "a", "", b"bytes")
        channel = writer.register_channel("/n", "json", 0)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    data, index = path.read_bytes(), read_index(open_source(path))
    (attachment,), (chunk,) = index.attachments, index.chunks
    begin, length = attachment.record - RECORD_HEAD, attachment.end + 4 - attachment.record + RECORD_HEAD
    told = data.rindex(struct.pack("<QQ", begin, length))
    for place in range(chunk.chunk.record - RECORD_HEAD, index.data_end):
        path.write_bytes(data[:told] + struct.pack("<Q", place) + data[told + 8 :])
        with pytest.raises(DamagedRecording, match=f"places a record at byte {place},"):
            read_index(open_source(path))


@pytest.mark.parametrize("place", [-1, -8, -8 - 20 - 9, -8 - 20 - 8])
def test_a_file_that_does_not_end_as_it_should_has_no_index(tmp_path: Path, place: int) -> None:
    """Take no index from a file with another byte in the magic at its end, or in the head of its footer."""
    path = tmp_path / "one.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, enable_crcs=False)
        writer.start()
        writer.add_message(writer.register_channel("/n", "json", 0), 0, b"{}", 0)
        writer.finish()
    assert read_index(open_source(path)) is not None
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    assert read_index(open_source(path)) is None


@pytest.mark.parametrize("more", [0, 1])
def test_a_chunk_has_no_more_messages_than_bytes_for_them(tmp_path: Path, more: int) -> None:
    """Refuse an index that lists more messages of a chunk than fit into it, and not for that reason one less."""
    path = tmp_path / "one.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
        writer.start()
        writer.add_message(writer.register_channel("/n", "json", 0), 0, b"{}", 0)
        writer.finish()
    data, index = bytearray(path.read_bytes()), read_index(open_source(path))
    (chunk,) = index.chunks
    told = data.rindex(struct.pack("<HQ", chunk.channels[0], chunk.places[0])) + 10
    assert struct.unpack_from("<Q", data, told) == (chunk.index_bytes,)
    most = chunk.chunk.uncompressed_size // 31
    struct.pack_into("<Q", data, told, 15 + 16 * (most + more))
    path.write_bytes(data)
    with pytest.raises(DamagedRecording) as refused:
        read_index(open_source(path))
    assert ("lists impossible messages" in str(refused.value)) is bool(more)


@pytest.mark.parametrize("others", [0, 1, 2])
def test_a_chunk_of_one_message_has_one(tmp_path: Path, others: int) -> None:
    """Refuse to read the message of a chunk that has more of them than its index says, all at one time."""
    path = tmp_path / "one.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE, enable_crcs=False)
        writer.start(FORMAT)
        number = writer.register_channel("/n", "json", 0)
        for sequence in range(1 + others):
            writer.add_message(number, 0, b"{}", 0, sequence)
        writer.finish()
    data, index = bytearray(path.read_bytes()), read_index(open_source(path))
    (chunk,) = index.chunks
    told = data.rindex(struct.pack("<HQ", chunk.channels[0], chunk.places[0])) + 10
    struct.pack_into("<Q", data, told, 15 + 16)  # of an index that lists one message
    struct.pack_into("<Q", data, data.rindex(struct.pack("<QHI", 1 + others, 0, 1)), 1)  # of the statistics
    name = f"one-message-{others}.mcap"
    fsspec.filesystem("memory").pipe(f"/{name}", bytes(data))
    container = Container(Location(f"memory://{name}"))
    (message,) = container.messages("/n")
    if others:
        with pytest.raises(DamagedRecording, match="does not hold the one message"):
            container.read(message)
    else:
        assert container.read(message)[0] == 0


def test_an_indexed_file_has_nothing_but_records(tmp_path: Path) -> None:
    """Name the byte at which a file that was opened through its summary has no record before its data end."""
    path, elsewhere = tmp_path / "one.mcap", Location("memory://nothing-but-records.mcap")
    with path.open("wb") as stream:
        writer = Writer(stream, enable_crcs=False)
        writer.start(FORMAT)
        writer.add_message(writer.register_channel("/n", "json", 0), 0, b"{}", 0)
        writer.add_metadata("m", {})
        writer.finish()
    memory, data = fsspec.filesystem("memory"), bytearray(path.read_bytes())
    memory.pipe("/nothing-but-records.mcap", bytes(data))
    Container(elsewhere).verify()
    begin = data.index(bytes([Op.METADATA]) + struct.pack("<QI", 9, 1) + b"m")
    data[begin] = 0
    memory.pipe("/nothing-but-records.mcap", bytes(data))
    with pytest.raises(DamagedRecording, match=f"what follows at byte {begin} is no record of the file's index"):
        Container(elsewhere).verify()
