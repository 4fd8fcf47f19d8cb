"""Files that the writer makes, read by others: the library of MCAP, and this project's own reader."""

from __future__ import annotations

import io
import os
import struct
import tempfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader

from gpusimbench.schemas import FORMAT
from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap.crc import combine
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.mcap.records import MAGIC, Op
from gpusimbench.schemas.mcap.writer import COMPRESSIONS, McapWriter, Part
from tests.limits import full_disk

Sent = list[tuple[str, int, bytes]]


@given(st.binary(max_size=300), st.binary(max_size=300))
def test_crc_of_two_parts(first: bytes, second: bytes) -> None:
    """Get the CRC of a whole from those of its parts."""
    assert combine(zlib.crc32(first), zlib.crc32(second), len(second)) == zlib.crc32(first + second)


def test_crc_of_large_parts() -> None:
    """Do so for lengths of many bits as well."""
    for size in (0, 1, 255, 256, 65537, (1 << 20) + 3):
        first, second = os.urandom(99), os.urandom(size)
        assert combine(zlib.crc32(first), zlib.crc32(second), size) == zlib.crc32(first + second)


def write(path: Path, sizes: Sequence[int], compression: str, *, finish: bool = True) -> Sent:
    """A file with messages of these sizes, on two channels in turn, an attachment and a metadata record."""
    sent: Sent = []
    with path.open("wb", buffering=0) as stream:
        writer = McapWriter(stream, profile=FORMAT, library="test", compression=compression)
        schema = writer.schema("a.B", "protobuf", b"schema")
        channels = {topic: writer.channel(topic, schema, {"unit": "m"}) for topic in ("/one", "/two")}
        writer.attachment("note.txt", "text/plain", b"a note", log_time=1, create_time=2)
        for number, size in enumerate(sizes):
            topic, data = ("/one", "/two")[number % 2], os.urandom(size)
            half = size // 2
            parts = [Part(data[:half]), Part(memoryview(data)[half:], zlib.crc32(data[half:]))]
            times = {"log_time": 100 - number, "publish_time": 7, "sequence": number // 2}
            writer.message(channels[topic], parts if number % 3 else data, **times)
            sent.append((topic, 100 - number, data))
        writer.metadata("facts", {"key": "value"})
        if finish:
            writer.finish()
        else:
            writer.flush()
    return sent


SIZES = (0, 5, 70_000, 200_000, 3, 300_001, 131_072, 40_000, 40_000, 60_000, 1)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_the_library_reads_it(tmp_path: Path, compression: str) -> None:
    """Give every byte back through the reader of the format's makers, with all its checks, by index and in order."""
    sent = write(tmp_path / "a.mcap", SIZES, compression)
    for make in (make_reader, NonSeekingReader):
        with (tmp_path / "a.mcap").open("rb") as stream:
            reader = make(stream, validate_crcs=True)
            found = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages(log_time_order=False)]
            assert sorted(found) == sorted(sent)
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert [(a.name, a.data) for a in reader.iter_attachments()] == [("note.txt", b"a note")]
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("facts", {"key": "value"})]
        summary = reader.get_summary()
        assert summary.statistics.message_count == len(sent)
        assert (summary.statistics.message_start_time, summary.statistics.message_end_time) == (90, 100)
        assert summary.statistics.channel_message_counts == {1: 6, 2: 5}
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
        assert {c.topic: c.metadata for c in summary.channels.values()} == {
            "/one": {"unit": "m"},
            "/two": {"unit": "m"},
        }


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_our_reader_reads_it(tmp_path: Path, compression: str) -> None:
    """Give every byte back through this project's reader, whose CRC of the data section agrees."""
    sent = write(tmp_path / "a.mcap", SIZES, compression)
    container = Container(tmp_path / "a.mcap")
    container.verify()
    assert container.finished
    for topic in ("/one", "/two"):
        found = {(m.log_time, bytes(container.read(m)[1])) for m in container.messages(topic)}
        assert found == {(time, data) for name, time, data in sent if name == topic}


@pytest.mark.parametrize("cut", (1, 40_000, 140_000))
def test_a_file_cut_short(tmp_path: Path, cut: int) -> None:
    """Read all whole chunks of a file without its end."""
    path = tmp_path / "a.mcap"
    sent = write(path, SIZES, "none", finish=False)
    os.truncate(path, path.stat().st_size - cut)
    container = Container(path)
    assert not container.finished
    found = [(c, m.log_time, bytes(container.read(m)[1])) for c in ("/one", "/two") for m in container.messages(c)]
    assert set(found) <= set(sent)
    assert len(found) >= 3


def test_every_large_message_has_left_the_process(tmp_path: Path) -> None:
    """Have a large message, and what came before it, in the file when the call returns."""
    path = tmp_path / "a.mcap"
    with path.open("wb", buffering=0) as stream:
        writer = McapWriter(stream, profile=FORMAT, library="test")
        channel = writer.channel("/one", writer.schema("a.B", "protobuf", b""), {})
        writer.message(channel, b"small", log_time=1, publish_time=1, sequence=0)
        writer.message(channel, bytes(200_000), log_time=2, publish_time=1, sequence=1)
        assert [m.log_time for m in Container(path).messages("/one")] == [1, 2]


def test_a_full_disk(tmp_path: Path) -> None:
    """Raise where the disk takes a part of a chunk only."""
    with (tmp_path / "a.mcap").open("wb", buffering=0) as stream:
        writer = McapWriter(stream, profile=FORMAT, library="test")
        channel = writer.channel("/one", writer.schema("a.B", "protobuf", b""), {})
        with full_disk(250_000):
            writer.message(channel, bytes(200_000), log_time=1, publish_time=1, sequence=0)
            with pytest.raises(OSError, match="File too large"):
                writer.message(channel, bytes(200_000), log_time=2, publish_time=1, sequence=1)
    assert [m.log_time for m in Container(tmp_path / "a.mcap").messages("/one")] == [1]


@pytest.mark.parametrize("most", [None, 999])
def test_a_message_of_many_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int | None) -> None:
    """Write more parts than the operating system takes in one call, also where it takes few bytes at a time."""
    parts = [os.urandom(1 + number % 200) for number in range(2500)]
    write_all = os.writev
    if most:
        monkeypatch.setattr(os, "writev", lambda at, pieces: write_all(at, [b"".join(pieces)[:most]]))
    with (tmp_path / "a.mcap").open("wb", buffering=0) as stream:
        writer = McapWriter(stream, profile=FORMAT, library="")
        channel = writer.channel("/many", writer.schema("empty", "protobuf", b""), {})
        writer.message(channel, [Part(part) for part in parts], log_time=1, publish_time=1, sequence=0)
        writer.finish()
    with (tmp_path / "a.mcap").open("rb") as stream:
        ((_, _, message),) = make_reader(stream, validate_crcs=True).iter_messages()
    assert message.data == b"".join(parts)


def test_a_chunk_ends_at_its_limit(tmp_path: Path) -> None:
    """Close the chunk of small messages when it reaches 128 KiB, and give a message as large one of its own."""
    limit, head = 128 * 1024, 31  # a record's bytes before a message's data
    sizes = (limit // 2 - head, limit // 2 - head, 0, limit - head, limit - head - 1, 0, 1)
    write(tmp_path / "a.mcap", sizes, "none")
    with (tmp_path / "a.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert [c.uncompressed_size for c in summary.chunk_indexes] == [limit, head, limit, limit - 1 + head, head + 1]


def _out_of_order(path: Path, late: int) -> Container:
    # a topic whose first message lies behind one of so many bytes
    with path.open("wb", buffering=0) as stream:
        writer = McapWriter(stream, profile=FORMAT, library="test")
        channel = writer.channel("/one", writer.schema("a.B", "protobuf", b"schema"), {})
        for sequence, data in ((1, bytes(late)), (0, b"first")):
            writer.message(channel, data, log_time=sequence, publish_time=0, sequence=sequence)
        writer.finish()
    return Container(path)


def test_messages_out_of_their_order(tmp_path: Path) -> None:
    """Keep 64 MiB of messages waiting for those before them, and no more."""
    found = _out_of_order(tmp_path / "a.mcap", (64 << 20) - 100)
    assert [len(content) for content in found.in_sequence("/one")] == [5, (64 << 20) - 100]
    assert [found.chunk_bytes(message) for message in found.messages("/one")] == [31 + 5, 31 + (64 << 20) - 100]
    with pytest.raises(DamagedRecording, match="message 0 of /one is missing, or far behind"):
        list(_out_of_order(tmp_path / "b.mcap", 64 << 20).in_sequence("/one"))


def test_offsets_of_the_summary(tmp_path: Path) -> None:
    """Say of each type of record where its group is in the summary: one after another, and nothing else there."""
    path = tmp_path / "a.mcap"
    write(path, [10, 20, 30], "zstd")
    data = path.read_bytes()
    begin, offsets, _ = struct.unpack_from("<QQI", data, len(data) - len(MAGIC) - 20)
    groups, at = [], offsets
    while data[at] == Op.SUMMARY_OFFSET:
        groups.append(struct.unpack_from("<BQQ", data, at + 9))
        at += 9 + 17
    assert at == len(data) - len(MAGIC) - 29  # the footer
    for opcode, start, length in groups:
        assert start == begin
        while begin < start + length:
            assert data[begin] == opcode
            begin += 9 + int.from_bytes(data[begin + 1 : begin + 9], "little")
        assert begin == start + length
    assert begin == offsets
    assert len({opcode for opcode, _, _ in groups}) == len(groups) == 6


def test_a_file_without_messages(tmp_path: Path) -> None:
    """Say of no messages what MCAP asks for: times of zero."""
    path = tmp_path / "empty.mcap"
    write(path, (), "none")
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary.statistics is not None
    found = summary.statistics
    assert (found.message_count, found.message_start_time, found.message_end_time) == (0, 0, 0)


@given(st.binary(min_size=1, max_size=50), st.lists(st.integers(0, 300_000), max_size=3), st.randoms())
def test_an_attachment_is_rewritten(note: bytes, sizes: list[int], random: Any) -> None:
    """Find the data that were put in place of an attachment's, and all CRCs right, whatever was written behind it."""
    other = random.randbytes(len(note))
    with tempfile.TemporaryFile(buffering=0) as stream:
        writer = McapWriter(stream, profile=FORMAT, library="test")
        channel = writer.channel("/one", writer.schema("a.B", "protobuf", b"schema"), {})
        writer.attachment("note.txt", "text/plain", note, log_time=1, create_time=2)
        for number, size in enumerate(sizes):
            writer.message(channel, bytes(size), log_time=number, publish_time=0, sequence=number)
        writer.rewrite_attachment("note.txt", other)
        with pytest.raises(ValueError, match="bytes"):
            writer.rewrite_attachment("note.txt", other + b"x")
        writer.rewrite_attachment("note.txt", other)
        writer.finish()
        stream.seek(0)
        whole = stream.read()
    assert [one.data for one in make_reader(io.BytesIO(whole)).iter_attachments()] == [other]
    end = whole.rindex(struct.pack("<BQ", Op.DATA_END, 4))
    assert struct.unpack_from("<I", whole, end + 9)[0] == zlib.crc32(whole[:end])
