"""Actions that every engine is given: a pure function of seed, environment and step."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.schemas.mix32 import GOLDEN32, mix32

GRID_BITS = 13
GRID = 2.0**-GRID_BITS
"""Targets are whole multiples of this [rad]: every float32 operation that makes one is exact, whatever device does it
and whether or not it fuses a multiplication with an addition."""

_WORD_BITS = 16  # of the random word that scales a range; a range of less than 2^16 steps keeps the product in 32 bits


@dataclass(frozen=True)
class JointTargets:
    """A target position for each joint at each step, uniform within its limits (to within GRID).

    The generator is counter-based, in 32-bit wrapping integers, so that any step of any environment can be made
    anywhere, in any order, on any device:

        w = mix(seed_low + G);  w = mix(w + seed_high + G)
        w = mix(w + (env + 1) * G);  w = mix(w + (step + 1) * G);  w = mix(w + (joint + 1) * G)
        target = (first[joint] + ((w >> 16) * count[joint] >> 16)) * GRID

    with mix the finaliser of MurmurHash3 and G = 0x9E3779B9 (``schemas.mix32``).

    name          of the topic
    joints        names, in the robot's order
    lower, upper  limits [rad]
    """

    name: str
    joints: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def grid(self) -> tuple[NDArray[np.int32], NDArray[np.uint32]]:
        """`first` and `count` for each joint: the targets are GRID times first .. first + count - 1."""
        first = np.array([math.ceil(x / GRID) for x in self.lower], dtype=np.int32)
        last = np.array([math.floor(x / GRID) for x in self.upper], dtype=np.int32)
        return first, (last - first + 1).astype(np.uint32)

    def seed_word(self, seed: int) -> int:
        """The word that `seed` begins the chain with, for generators on a device."""
        low, high = seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF
        golden = np.uint32(GOLDEN32)
        word = mix32(np.array([low], dtype=np.uint32) + golden)
        return int(mix32(word + np.uint32(high) + golden)[0])

    def draw(self, seed: int, *, n_env: int, first_step: int, n_step: int, first_env: int = 0) -> NDArray[np.float32]:
        """Targets [rad], shape [step, env, joint], of n_env environments from first_env on; row i leads from the state
        of step first_step + i to the next."""
        counters = (
            first_env + np.arange(n_env)[None, :, None],
            first_step + np.arange(n_step)[:, None, None],
            np.arange(len(self.joints))[None, None, :],
        )
        golden = np.uint32(GOLDEN32)
        word = np.array([[[self.seed_word(seed)]]], dtype=np.uint32)
        for counter in counters:
            word = mix32(word + (counter + 1).astype(np.uint32) * golden)
        first, count = self.grid()
        index = (word >> np.uint32(32 - _WORD_BITS)) * count >> np.uint32(_WORD_BITS)
        return (first + index.astype(np.int32)).astype(np.float32) * np.float32(GRID)

    def describe(self, seed: int) -> str:
        """The generator with all that it depends on (JSON)."""
        return json.dumps(
            {
                "generator": "murmur3-fmix32-grid13",
                "name": self.name,
                "seed": seed,
                "joints": self.joints,
                "lower": self.lower,
                "upper": self.upper,
            }
        )
