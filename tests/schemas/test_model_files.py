"""Archives of model files as attachments: every byte comes back, and a reader never takes more than it is told."""

from __future__ import annotations

import hashlib
import struct

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas.errors import DamagedRecording
from gpusimbench.schemas.model_files import _WORTH_BYTES, COMPRESSED, MAX_ARCHIVE_BYTES, MODEL, attachment, plain
from tests.encoded import announcing
from tests.limits import next_to_no_memory


@given(
    parts=st.lists(st.tuples(st.binary(min_size=1, max_size=200), st.integers(1, 2000)), max_size=5),
    rest=st.binary(max_size=300),
)
def test_every_byte_comes_back(parts: list[tuple[bytes, int]], rest: bytes) -> None:
    """Attach the very archive, or a frame of it that saves enough."""
    archive = b"".join(part * times for part, times in parts) + rest
    name, media_type, data = attachment(archive)
    assert plain(name, data) == archive
    if name == COMPRESSED:
        assert media_type == "application/zstd"
        assert len(archive) - len(data) >= _WORTH_BYTES
    else:
        assert (name, media_type, data) == (MODEL, "application/zip", archive)


def test_what_saves_enough_is_compressed() -> None:
    """Compress text; leave what is small, and what is random, as it is."""
    noise = b"".join(hashlib.sha256(number.to_bytes(4)).digest() for number in range(8192))
    assert attachment(noise)[0] == MODEL
    assert attachment(b"<mujoco/>" * (_WORTH_BYTES // 9))[0] == MODEL
    assert attachment(b"<mujoco/>" * (_WORTH_BYTES // 8))[0] == COMPRESSED


def test_other_attachments_are_as_they_are() -> None:
    """Decompress nothing that has another name."""
    assert plain("other.zst", _FRAME) == _FRAME
    assert plain(MODEL, _FRAME) == _FRAME


_FRAME = zstandard.ZstdCompressor(write_checksum=False).compress(b"\x07" * 48)
_STREAM = zstandard.ZstdCompressor(write_content_size=False).compress(b"\x07" * 48)
_BOMB = zstandard.compress(bytes(1 << 25))  # 32 MiB in about a kilobyte


def test_a_frame_that_says_its_size_in_eight_bytes_is_read() -> None:
    """Show that the frames below are refused for the size that they announce alone."""
    assert plain(COMPRESSED, announcing(_FRAME, 48)) == b"\x07" * 48


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (announcing(_FRAME, 1 << 42), f"announces {1 << 42} bytes, and at most {MAX_ARCHIVE_BYTES} bytes are read"),
        (announcing(_FRAME, MAX_ARCHIVE_BYTES + 1), "at most"),
        (announcing(_FRAME, MAX_ARCHIVE_BYTES), f"announces {MAX_ARCHIVE_BYTES} bytes, more than its .* can hold"),
        (announcing(_FRAME, 47), "cannot be decompressed"),
        (announcing(_FRAME, 49), "cannot be decompressed"),
        (_BOMB[:4] + b"\x60" + struct.pack("<H", 1000 - 256) + _BOMB[9:], "cannot be decompressed"),
        (_STREAM, "announces no size"),
        (_FRAME + _FRAME, "cannot be decompressed"),
        (b"", "model.zip.zst: "),
        (b"PK nothing of the kind", "model.zip.zst: "),
    ],
)
def test_liars_are_refused(data: bytes, said: str) -> None:
    """Name the attachment and what is wrong with it, and allocate next to nothing for finding out."""
    with next_to_no_memory(), pytest.raises(DamagedRecording, match=said):
        plain(COMPRESSED, data)


@given(length=st.integers(0, len(_BOMB) - 1))
def test_a_frame_that_was_cut_is_refused(length: int) -> None:
    """Read no part of an archive."""
    with pytest.raises(DamagedRecording, match=COMPRESSED):
        plain(COMPRESSED, _BOMB[:length])
