"""Images of environments as 64-bit hashes: 16 bytes a frame, by which recordings show where pictures first differ."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.fingerprint import ALGORITHM, fingerprint

_WORD = 8


def image_hashes(frames: NDArray[Any], lead: int = 1) -> NDArray[np.float64]:
    """The hash of each frame as two whole numbers, its low and its high 32 bits; shape [env, 2].

    frames  [env, ...] of numbers of any dtype, such as [env, height, width, channel] of uint8
    lead    leading axes that count frames: 2 of [step, env, ...], which gives [step, env, 2]

    The hash is that of schemas.fingerprint, over the bytes of a frame, row-major and little-endian, with zeros behind
    them up to a multiple of 8, as unsigned 64-bit words. Frames of one shape and dtype that differ in one word have
    different hashes.
    """
    counted = frames.shape[:lead]
    plain = np.ascontiguousarray(frames, dtype=frames.dtype.newbyteorder("<"))
    data = plain.reshape(math.prod(counted), -1).view(np.uint8)
    if short := -data.shape[1] % _WORD:
        data = np.pad(data, ((0, 0), (0, short)))
    hashes = fingerprint([data.view("<u8")[:, np.newaxis]])
    return hashes.astype("<u8").view("<u4").astype(np.float64).reshape(*counted, 2)


def image_hash_note(dtype: Any, shape: tuple[int, ...]) -> str:
    """What a field of image_hashes says of its numbers.

    dtype, shape  of a frame
    """
    size = "x".join(map(str, shape))
    return f"low and high 32 bits of the {ALGORITHM} hash of each image, {dtype} {size}, which is not recorded itself"
