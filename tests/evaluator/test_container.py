"""Files that are whole, cut short, damaged, or something else."""

from __future__ import annotations

import io
import random
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer

from gpusimbench import open_recording
from gpusimbench.evaluator.runs.validation import verify
from gpusimbench.schemas.errors import DamagedRecording, NotARecording, RecordingError
from gpusimbench.schemas.mcap import reader
from gpusimbench.schemas.mcap.reader import Container
from tests.forging import copied
from tests.reading import verified
from tests.synthetic import grid, write_recording

compressions = pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """A small whole recording."""
    return write_recording(tmp_path, grid(2), name="tiny.mcap")


@compressions
def test_same_content_however_compressed(tmp_path: Path, compression: str) -> None:
    """Give the same arrays and the same digests whatever the chunks are compressed with."""
    final = np.random.default_rng(0).standard_normal((3, 27, 3))
    recording = verified(write_recording(tmp_path, final, compression=compression))
    assert np.array_equal(recording.state("cubes", "position")[-1], final)


@compressions
def test_rewritten_by_another_tool(tmp_path: Path, compression: str) -> None:
    """Keep arrays, status and identity when another writer copies the messages into other chunks."""
    original = write_recording(tmp_path, grid(3))
    copy = tmp_path / "copy.mcap"
    copied(original, copy, compression=CompressionType[compression.upper()], chunk_size=700)
    a, b = open_recording(original), open_recording(copy)
    verify(b)
    assert a.content_hash == b.content_hash
    assert np.array_equal(np.asarray(a.state("cubes", "position")), np.asarray(b.state("cubes", "position")))


def test_without_chunks_or_indexes(tmp_path: Path) -> None:
    """Read a file that has neither chunks nor message indexes."""
    original = write_recording(tmp_path, grid(2))
    copy = tmp_path / "flat.mcap"
    copied(original, copy, use_chunking=False)
    verify(open_recording(copy))


def test_cut_short_anywhere(tiny: Path, tmp_path: Path) -> None:
    """Read a file cut at any byte as incomplete, up to its last whole record, or refuse it; never as complete."""
    data = tiny.read_bytes()
    whole = np.asarray(open_recording(tiny).state("cubes", "position"))
    cut = tmp_path / "cut.mcap"
    seen = set()
    for size in [*range(0, len(data) - 1, 311), *range(len(data) - 60, len(data))]:
        cut.write_bytes(data[:size])
        try:
            recording = open_recording(cut)
        except RecordingError:
            seen.add("refused")
            continue
        assert recording.status == "incomplete"
        seen.add("incomplete")
        if recording.fields:
            array = recording.state("cubes", "position")
            assert np.array_equal(array[:], whole[: len(array)])
            seen.add(len(array))
    assert {"refused", "incomplete", 0, 6} <= seen


@compressions
def test_no_flipped_bit_passes(tmp_path: Path, compression: str) -> None:
    """Notice every single flipped bit: refused on opening, or by verify; no wrong number is handed out."""
    source = write_recording(tmp_path, grid(1), compression=compression)
    data = source.read_bytes()
    flipped = tmp_path / "flipped.mcap"
    rng = random.Random(1)
    passed = []
    for _ in range(300):
        changed = bytearray(data)
        position = rng.randrange(len(data))
        changed[position] ^= 1 << rng.randrange(8)
        flipped.write_bytes(changed)
        try:
            recording = verified(flipped)
        except RecordingError:
            continue
        if recording.status == "incomplete":
            continue
        passed.append(position)
    assert not passed


def test_something_else_is_named(tmp_path: Path) -> None:
    """Tell apart what is no MCAP, a foreign MCAP, another version of the format, and no file at all."""
    text = tmp_path / "notes.mcap"
    text.write_text("these are not the bytes that you are looking for")
    empty = tmp_path / "empty.mcap"
    empty.write_bytes(b"")
    for path in (text, empty):
        with pytest.raises(NotARecording, match="is not an MCAP file"):
            open_recording(path)
    with pytest.raises(NotARecording, match="No such file"):
        open_recording(tmp_path / "missing.mcap")
    with pytest.raises(NotARecording, match="Is a directory"):
        open_recording(tmp_path)
    for profile, message in (("ros2", "not a recording of a simulator"), ("gsb.v9", "format gsb.v9.*update")):
        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start(profile=profile)
        writer.finish()
        path = tmp_path / f"{profile}.mcap"
        path.write_bytes(stream.getvalue())
        with pytest.raises(NotARecording, match=message):
            open_recording(path)


def test_bytes_that_change_after_they_were_verified(tmp_path: Path) -> None:
    """Notice that a number of a state was overwritten in the file itself, though its chunk was read before."""
    path = write_recording(tmp_path, grid(3), steps=5)
    recording = verified(path)
    container = recording._container
    (topic,) = [topic for topic in container.channels if topic.startswith("/state/")]
    content = container.read(container.messages(topic)[0])[1]
    with path.open("r+b") as stream:
        at = path.read_bytes().index(bytes(content)) + len(content) - 3
        stream.seek(at)
        stream.write(bytes([path.read_bytes()[at] ^ 1]))
    with pytest.raises(DamagedRecording, match="CRC"):
        np.asarray(recording.state("cubes", "position"))


def _in_order(tmp_path: Path, sequence: list[int]) -> Iterator[memoryview]:
    # messages of 100 bytes, written with these numbers
    path = tmp_path / "numbered.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=1)
        writer.start(profile="gsb.v1")
        channel = writer.register_channel("/topic", "json", 0)
        for at, number in enumerate(sequence):
            writer.add_message(channel, at, number.to_bytes(100, "little"), at, number)
        writer.finish()
    return Container(path).in_sequence("/topic")


def test_messages_wait_for_those_before_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give messages in their order, and hold so many bytes at most of those that came too early, however many came."""
    monkeypatch.setattr(reader, "_HELD_BYTES", 250)
    swapped = [number ^ 1 for number in range(40)]
    assert [int.from_bytes(one, "little") for one in _in_order(tmp_path, swapped)] == list(range(40))
    for early, said in (
        ([1, 0, 3, 4], "message 2 of /topic is missing$"),
        ([1, 0, 3, 4, 5], "message 2 .* far behind"),
    ):
        with pytest.raises(DamagedRecording, match=said):
            list(_in_order(tmp_path, early))
    with pytest.raises(DamagedRecording, match="message 1 of /topic is there twice"):
        list(_in_order(tmp_path, [0, 1, 1]))


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_the_crc_of_a_chunk_gives_that_of_its_message(tmp_path: Path, compression: str) -> None:
    """Give the CRC of a block that has a chunk of its own, and none that would be wrong."""
    container = Container(write_recording(tmp_path, grid(4), steps=50, compression=compression))
    found = {
        topic: [container.read_with_crc(message)[1:] for message in container.messages(topic)]
        for topic in container.channels
    }
    for content, crc in (one for messages in found.values() for one in messages):
        assert crc in (None, zlib.crc32(content))
    assert {crc is None for _, crc in found["/state/cubes/position/000000"]} == {False}


def test_how_large_an_attachment_may_be(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read an attachment of the largest size, and refuse one that has a byte more."""
    container = Container(tiny)
    name = container.attachment_names()[0]
    content = container.attachment(name)
    assert content
    monkeypatch.setattr(reader, "MAX_ATTACHMENT_BYTES", len(content))
    assert container.attachment(name) == content
    monkeypatch.setattr(reader, "MAX_ATTACHMENT_BYTES", len(content) - 1)
    with pytest.raises(DamagedRecording, match=f"more than the {len(content) - 1} bytes"):
        container.attachment(name)
