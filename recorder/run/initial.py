"""Initial states that are drawn, so that environments do not all begin alike."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mix32 import GOLDEN32, mix32
from gpusimbench.schemas.treatment import MOST_SPREAD, Initial

GRID = 2.0**-13
"""What is added is a whole multiple of this [m/s or rad], so that the sum with zero is exact in either precision."""

_STREAM = 0x494E4954  # tells these words from those of actions, which the same seed draws


def states(
    initial: Initial, scene: Scene, fields: tuple[StateField, ...], first: States, seed: int
) -> tuple[NDArray[np.floating], ...]:
    """The first state [env, item, width] of each field, in its precision, with what is drawn for it added.

    Added is, uniformly within +- spread and independently for each environment:

        to the linear velocity of every free body, along each axis [m/s]
        to the angle of every joint [rad], kept within its limits

    No body is moved, so that none penetrates another.
    """
    found, limits = [], scene.joint_limits()
    for place, (layout, array) in enumerate(zip(fields, first, strict=True)):
        if layout.field not in ("linear_velocity", "qpos"):
            found.append(array.copy())
            continue
        given = array + draw(initial, seed, place, array.shape).astype(array.dtype)
        if layout.field == "qpos" and layout.group in limits:
            bounds = np.array(limits[layout.group], dtype=array.dtype)
            given = np.clip(given, bounds[:, :1], bounds[:, 1:])
        found.append(given.astype(array.dtype))
    return tuple(found)


def draw(initial: Initial, seed: int, field: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """What is added to a field of this shape [env, item, width], the `field`-th of the layout.

    The generator is counter-based, in 32-bit wrapping integers:

        w = mix(mix(mix(seed_low + G) + seed_high + G) + stream)
        w = mix(w + (field + 1) * G), and the same with the environment, the item and the component
        added = ((w >> 16) * (2 k + 1) >> 16) - k, times GRID, with k = floor(spread / GRID)

    with mix the finaliser of MurmurHash3, G = 0x9E3779B9 (``schemas.mix32``) and stream 0x494E4954. Environment e
    counts as (e + shift) modulo their number; with `but`, all others than that one have the stream plus 1.
    """
    n_env, *inner = shape
    envs = (np.arange(n_env) + initial.shift) % n_env
    stream = np.full(n_env, _STREAM, dtype=np.uint32)
    if initial.but is not None:
        stream[np.arange(n_env) != initial.but] += np.uint32(1)
    golden, most = np.uint32(GOLDEN32), math.floor(initial.spread / GRID)
    word = np.array([seed & 0xFFFFFFFF], dtype=np.uint32)
    word = mix32(mix32(word + golden) + np.uint32((seed >> 32) & 0xFFFFFFFF) + golden)
    word = mix32(mix32(word + stream) + np.array([field + 1], dtype=np.uint32) * golden)
    word = mix32(word + (envs + 1).astype(np.uint32) * golden)
    for count in inner:
        word = mix32(word[..., None] + np.arange(1, count + 1, dtype=np.uint32) * golden)
    index = (word >> np.uint32(16)) * np.uint32(2 * most + 1) >> np.uint32(16)
    return np.asarray((index.astype(np.int64) - most) * GRID, dtype=np.float64)


def parse(text: str, n_env: int) -> str:
    """What --initial says of drawn states, as the recording keeps it. UsageError where nothing can be drawn so."""
    try:
        drawn = Initial.parse(text)
        if drawn.spread < GRID or (drawn.but or 0) >= n_env:
            raise ValueError(text)
    except ValueError:
        raise UsageError(
            f"--initial is random:SPREAD, with a spread from {GRID:.2g} to {MOST_SPREAD:g} (of velocities in m/s, of "
            "joint angles in rad), and may end with ,shift:K or with ,but:E, an environment, "
            f"not '{text}'"
        ) from None
    return str(drawn)
