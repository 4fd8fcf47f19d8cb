"""Numbers that are drawn for environments by counters, the same on every machine and for every engine."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.initial import Initial
from gpusimbench.schemas.mixing import GOLDEN32, mix32
from gpusimbench.schemas.treatment import Vary

GRID = 2.0**-13
"""What is drawn is a whole multiple of this, so that its sum with zero or one is exact in either precision."""


def draw(
    how: Initial | Vary, spread: float, *, seed: int, stream: int, field: int, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """Uniform numbers within +- spread, of this shape [env, ...].

    stream  tells these words from others that the same seed draws
    field   of several in a stream, from 0

    The generator is counter-based, in 32-bit wrapping integers:

        w = mix(mix(mix(seed_low + G) + seed_high + G) + stream)
        w = mix(w + (field + 1) * G), and the same with the environment and each further index
        drawn = ((w >> 16) * (2 k + 1) >> 16) - k, times GRID, with k = floor(spread / GRID)

    with mix the finaliser of MurmurHash3, G = 0x9E3779B9 (``schemas.mixing``). Environment e counts as (e + shift)
    modulo their number; with `but`, all others than that one have the stream plus 1.
    """
    n_env, *inner = shape
    envs = (np.arange(n_env) + how.shift) % n_env
    streams = np.full(n_env, stream, dtype=np.uint32)
    if how.but is not None:
        streams[np.arange(n_env) != how.but] += np.uint32(1)
    golden, most = np.uint32(GOLDEN32), math.floor(spread / GRID)
    word = np.array([seed & 0xFFFFFFFF], dtype=np.uint32)
    word = mix32(mix32(word + golden) + np.uint32((seed >> 32) & 0xFFFFFFFF) + golden)
    word = mix32(mix32(word + streams) + np.array([field + 1], dtype=np.uint32) * golden)
    word = mix32(word + (envs + 1).astype(np.uint32) * golden)
    for count in inner:
        word = mix32(word[..., None] + np.arange(1, count + 1, dtype=np.uint32) * golden)
    index = (word >> np.uint32(16)) * np.uint32(2 * most + 1) >> np.uint32(16)
    return np.asarray((index.astype(np.int64) - most) * GRID, dtype=np.float64)
