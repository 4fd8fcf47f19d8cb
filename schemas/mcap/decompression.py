"""Chunks of an MCAP file decompressed: never into more than they announce, and never more than can be in them."""

from __future__ import annotations

MAX_BYTES = 1 << 30
"""A chunk that announces more decompressed bytes is refused before anything is allocated."""

_MOST_PER_BYTE = {"zstd": 1 << 15, "lz4": 1 << 8}
"""By method, more than its format can make of one byte: a block of Zstandard takes 4 bytes at least and gives 128 KiB
at most (RFC 8878, 3.1.1.2); a byte of LZ4 lengthens a match by 255 at most."""

_HEADROOM = 1 << 16


def known(compression: str) -> bool:
    """Whether chunks that are compressed with this method, "" for none, can be read."""
    return compression in ("", *_MOST_PER_BYTE)


def limit(compression: str, stored: int) -> int:
    """How many bytes `stored` bytes can become at most."""
    return min(MAX_BYTES, stored * _MOST_PER_BYTE.get(compression, 1) + _HEADROOM) if compression else stored


def decompress(compression: str, stored: memoryview, size: int) -> memoryview:
    """The bytes of a chunk, `size` of them; without a compression they are where they lie.

    ValueError where they are fewer or more, where the method is not known, or where anything else is in the way.
    """
    if not known(compression):
        raise ValueError(f"it is compressed with {compression[:40]!r}, which is not known here")
    if size > limit(compression, len(stored)):
        raise ValueError(f"it announces {size} bytes, more than its {len(stored)} can hold or may be read")
    if not compression:
        data: bytes | memoryview = stored
    else:
        try:
            data = _zstd(stored, size) if compression == "zstd" else _lz4(stored, size)
        except Exception as error:  # each library has its own; all mean that the bytes are not what they should be
            raise ValueError(f"it cannot be decompressed: {str(error) or type(error).__name__}") from None
    if len(data) != size:
        raise ValueError(f"it holds {len(data)} bytes instead of the {size} that it announces")
    return memoryview(data)


def _zstd(stored: memoryview, size: int) -> bytes:
    import zstandard

    # the size in the frame decides what is allocated, whatever the limit asked for
    if zstandard.frame_content_size(stored) > size:
        raise ValueError("it holds more than it announces")
    return zstandard.ZstdDecompressor().decompress(stored, max_output_size=size, allow_extra_data=False)


def _lz4(stored: memoryview, size: int) -> bytes:
    import lz4.frame

    with lz4.frame.LZ4FrameDecompressor() as frame:
        data: bytes = frame.decompress(bytes(stored), max_length=size)
        if not frame.eof or frame.unused_data:
            raise ValueError("its frame does not end where it should")
        return data
