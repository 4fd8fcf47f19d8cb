"""Chunks decompressed: exactly what they announce, or the reason why not."""

from __future__ import annotations

import lz4.frame
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.schemas.mcap.decompression import decompress, limit

PACK = {"": bytes, "zstd": zstandard.ZstdCompressor().compress, "lz4": lz4.frame.compress}


@given(st.binary(max_size=300), st.sampled_from(list(PACK)), st.integers(-2, 2))
def test_what_it_announces(content: bytes, method: str, off: int) -> None:
    """Give the bytes of a chunk that announces their number, and refuse one that announces another."""
    stored, size = memoryview(PACK[method](content)), len(content) + off
    if off == 0:
        assert bytes(decompress(method, stored, size)) == content
    elif size >= 0:
        with pytest.raises(ValueError, match=f"announces|^it (cannot be|holds)|{size}"):
            decompress(method, stored, size)


@pytest.mark.parametrize(
    ("method", "stored", "size", "said"),
    [
        ("bzip2", b"abc", 3, "it is compressed with 'bzip2', which is not known here"),
        ("", b"abc", 4, "it announces 4 bytes, more than its 3 can hold or may be read"),
        ("", b"abc", 2, "it holds 3 bytes instead of the 2 that it announces"),
        ("zstd", PACK["zstd"](b"abc"), 4, "it holds 3 bytes instead of the 4 that it announces"),
        ("zstd", PACK["zstd"](b"abc"), 2, "it cannot be decompressed: it holds more than it announces"),
        ("lz4", PACK["lz4"](b"abc"), 2, "it cannot be decompressed: its frame does not end where it should"),
        ("lz4", PACK["lz4"](b"abc") + b"d", 3, "it cannot be decompressed: its frame does not end where it should"),
    ],
)
def test_why_not(method: str, stored: bytes, size: int, said: str) -> None:
    """Say what is wrong, in the words of the library where it has some."""
    with pytest.raises(ValueError) as refused:
        decompress(method, memoryview(stored), size)
    assert str(refused.value) == said


def test_how_much_may_come_of_it() -> None:
    """Allow what a method can make of so many bytes and a little more, at most a gibibyte; plain ones stay."""
    assert [limit("", n) for n in (0, 5, 1 << 40)] == [0, 5, 1 << 40]
    assert [limit("zstd", n) for n in (0, 2, 1 << 20)] == [1 << 16, 2 * 32768 + 65536, 1 << 30]
    assert [limit("lz4", n) for n in (0, 2, 1 << 30)] == [1 << 16, 2 * 256 + 65536, 1 << 30]
    assert [limit("unknown", n) for n in (0, 2, 1 << 30)] == [1 << 16, 2 + 65536, 1 << 30]
