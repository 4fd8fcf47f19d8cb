"""The one walk over records: what a plain one refuses, a strict one reports and goes on behind."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.mcap.records import MAGIC, Op, Record
from gpusimbench.schemas.mcap.walk import Walk
from gpusimbench.schemas.source import MappedFile
from tests.synthetic import grid, write_recording


def _record(opcode: int, content: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def _visit(walk: Walk) -> list[int]:
    # opcodes of all records, those of chunks in their place; everything that has a CRC is checked
    found = []
    for record in walk:
        found.append(record.opcode)
        if record.opcode == Op.CHUNK:
            found += [inner.opcode for inner in walk.inside(record, walk.head(record))]
        elif record.opcode == Op.ATTACHMENT:
            walk.attached(record, walk.attachment(record))
        elif record.opcode == Op.DATA_END:
            walk.data_end(record)
    return found


def _strict(path: Path) -> tuple[list[int], list[tuple[str, str]]]:
    told: list[tuple[str, str]] = []
    return _visit(Walk(MappedFile(path), lambda fault, what: told.append((fault, what)))), told


def _position(data: bytes, opcode: int) -> int:
    at = len(MAGIC)
    while data[at] != opcode:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return at


@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_good_file(tmp_path: Path, compression: str) -> None:
    """Visit the same records in both modes, and report nothing."""
    path = write_recording(tmp_path, grid(2), compression=compression)
    found, told = _strict(path)
    assert not told
    assert found == _visit(Walk(MappedFile(path)))
    assert {Op.HEADER, Op.MESSAGE, Op.ATTACHMENT, Op.DATA_END, Op.FOOTER} <= set(found)


@pytest.mark.parametrize(
    ("opcode", "at", "fault", "said"),
    [
        (Op.CHUNK, 9 + 8 + 8 + 8 + 4 + 4 + 8 + 40, "chunk_crc", "fails its CRC"),
        (Op.ATTACHMENT, 9 + 16 + 4 + 20 + 4 + 20, "attachment_crc", "fails its CRC"),
    ],
)
def test_a_changed_byte(tmp_path: Path, opcode: int, at: int, fault: str, said: str) -> None:
    """Raise in the plain mode; in the strict one name each part that was changed, and visit what follows."""
    path = write_recording(tmp_path, grid(2))
    data = bytearray(path.read_bytes())
    data[_position(data, opcode) + at] ^= 1
    path.write_bytes(data)
    with pytest.raises(DamagedRecording, match=said):
        _visit(Walk(MappedFile(path)))
    found, told = _strict(path)
    assert found[-1] == Op.FOOTER
    assert [kind for kind, _ in told] == [fault, "data_crc"]
    assert said in told[0][1]


@pytest.mark.parametrize(
    ("record", "fault", "said"),
    [
        (_record(Op.HEADER, bytes(8)), "record", "there is a second header at byte"),
        (_record(Op.STATISTICS, bytes(50)), "record", "a record of the summary, type 11, lies before"),
        (_record(0x20, b"x"), "unknown_record", "a record of type 0x20 at byte"),
        (_record(0), "unknown_record", "a record of type 0x00 at byte"),
        (_record(0x90, b"an application's"), "", ""),
    ],
)
def test_records_that_cannot_be_there(tmp_path: Path, record: bytes, fault: str, said: str) -> None:
    """Report with its place what stands where it cannot, or has no type of MCAP; pass over what applications add."""
    path = write_recording(tmp_path, grid(2))
    whole, _ = _strict(path)
    data = path.read_bytes()
    at = _position(data, Op.ATTACHMENT)
    path.write_bytes(data[:at] + record + data[at:])
    found, told = _strict(path)
    assert found == whole
    assert [kind for kind, _ in told if kind != "data_crc"] == ([fault] if fault else [])
    if fault:
        assert said in told[0][1]


def test_zeros_end_a_plain_walk(tmp_path: Path) -> None:
    """Take what a crash leaves behind the last record for the end of the file."""
    path = write_recording(tmp_path, grid(2))
    data = path.read_bytes()
    at = _position(data, Op.DATA_END)
    path.write_bytes(data[:at] + bytes(100))
    walk = Walk(MappedFile(path))
    assert Op.DATA_END not in _visit(walk)
    assert walk.end == at


def test_a_record_names_its_place(tmp_path: Path) -> None:
    """Say of a record that is too short for its own head where it is."""
    with pytest.raises(DamagedRecording, match="short.mcap: a message at byte 7 is shorter than its own head"):
        Record(Op.MESSAGE, 7, memoryview(bytes(21))).message(tmp_path / "short.mcap")


@pytest.mark.parametrize(
    ("opcode", "fault"),
    [(0, "unknown_record"), (1, "record"), (Op.DATA_END, "record"), (Op.DATA_END + 1, "unknown_record")],
)
def test_records_that_are_in_no_chunk(tmp_path: Path, opcode: int, fault: str) -> None:
    """Tell a record that does not belong into a chunk from one that the format does not know."""
    told: list[str] = []
    walk = Walk(MappedFile(write_recording(tmp_path, grid(2))), lambda fault, _: told.append(fault))
    assert not list(walk.within(memoryview(_record(opcode)), 100))
    assert told == [fault]


@pytest.mark.parametrize(("last", "whole"), [(b"", True), (b"content", True), (b"content", False)])
def test_the_last_record_of_a_file_without_an_end(tmp_path: Path, last: bytes, whole: bool) -> None:
    """Take a record for whole up to the last byte of a file, also one without content, and one that is cut for none."""
    path = write_recording(tmp_path, grid(2))
    data = path.read_bytes()
    at = _position(data, Op.DATA_END)
    record = _record(0x90, last)
    path.write_bytes(data[:at] + (record if whole else record[:-1]))
    walk = Walk(MappedFile(path))
    _visit(walk)
    assert walk.end == (at + len(record) if whole else at)


def test_bytes_behind_what_a_chunk_holds(tmp_path: Path) -> None:
    """Refuse a chunk that is longer than it says in a strict walk, and pass over the rest in a plain one."""
    path = write_recording(tmp_path, grid(2))
    data = path.read_bytes()
    at = _position(data, Op.CHUNK)
    (length,) = struct.unpack_from("<Q", data, at + 1)
    end = at + 9 + length
    path.write_bytes(data[: at + 1] + struct.pack("<Q", length + 1) + data[at + 9 : end] + b"x" + data[end:])
    plain, strict = Walk(MappedFile(path)), Walk(MappedFile(path), lambda fault, what: None)
    first, again = (next(record for record in walk if record.opcode == Op.CHUNK) for walk in (plain, strict))
    head = plain.head(first)
    assert head.chunk.end == end
    with pytest.raises(DamagedRecording, match="is longer than its fields state"):
        strict.head(again)
