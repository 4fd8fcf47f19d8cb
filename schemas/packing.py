"""Arrays of floats made small without losing a bit: the encoding ENCODING_DELTA_SHUFFLE_ZSTD of a StateBlock.

Numbers of neighbouring steps share their high bits. So the words of a row are subtracted from those of the next, as
integers that wrap around; signs are folded into the lowest bit; time is made to run fastest, bytes of equal weight are
put together, and Zstandard finds what repeats. The definition, step by step, is in state_block.proto.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.mcap import decompression

LEVELS = range(1, 23)
"""Of Zstandard."""

DEFAULT_LEVEL = 1


def pack(array: NDArray[Any], *, level: int = DEFAULT_LEVEL) -> bytes:
    """One Zstandard frame from a little-endian array of float32 or float64 of any shape whose first axis is time.

    level  of Zstandard, in LEVELS
    """
    import zstandard

    size = array.dtype.itemsize
    words = np.ascontiguousarray(array).reshape(-1).view(f"<i{size}").reshape(_rows(array.shape))
    rows = words.copy()
    folded = rows[1:]
    folded -= words[:-1]
    signs = folded >> (8 * size - 1)  # all bits of a word are its sign
    folded <<= 1
    folded ^= signs
    time_last = np.ascontiguousarray(rows.T).reshape(-1)
    shuffled = np.ascontiguousarray(time_last.view(np.uint8).reshape(-1, size).T)
    frame: bytes = zstandard.ZstdCompressor(level=level).compress(shuffled.data)
    return frame


def check_frame(frame: memoryview, size: int) -> None:
    """ValueError where a frame does not announce `size` bytes, or they are more than it can hold or may be read."""
    import zstandard

    if size > decompression.limit("zstd", len(frame)):
        raise ValueError(f"{size} bytes are more than its {len(frame)} can hold or may be read")
    try:
        announced = zstandard.frame_content_size(frame)
    except zstandard.ZstdError as error:
        raise ValueError(f"it is no Zstandard frame: {error}") from None
    if announced != size:
        raise ValueError(f"its frame announces {announced if announced >= 0 else 'no'} bytes instead of {size}")


def unpack(frame: memoryview, shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The array of a shape, time first, and a little-endian dtype that `pack` made a frame of.

    ValueError where the frame is not one of such an array; nothing of its size is allocated before it was checked.
    """
    size = math.prod(shape) * dtype.itemsize
    check_frame(frame, size)
    content = decompression.decompress("zstd", frame, size)
    planes = np.frombuffer(content, dtype=np.uint8).reshape(dtype.itemsize, -1)
    by_word = np.empty(planes.shape[::-1], dtype=np.uint8)
    for weight, plane in enumerate(planes):  # several times faster than a transposition of rows that short
        by_word[:, weight] = plane
    words = by_word.reshape(-1).view(f"<u{dtype.itemsize}").reshape(_rows(shape)[::-1])
    folded = words[:, 1:]
    signs = folded & 1
    np.negative(signs, out=signs)
    folded >>= 1
    folded ^= signs
    words = np.add.accumulate(words, axis=1, dtype=words.dtype)
    return words.T.copy(order="C").reshape(-1).view(dtype).reshape(shape)


def _rows(shape: tuple[int, ...]) -> tuple[int, int]:
    # steps, and numbers of a step
    return shape[0], math.prod(shape[1:])
