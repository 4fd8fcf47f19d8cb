"""Actions that every engine is given: a pure function of seed, step and environment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from schemas.splitmix import GOLDEN, mix

_MANTISSA = 24  # bits of a float32: every engine gets exactly the same number


@dataclass(frozen=True)
class JointTargets:
    """A target position for each joint at each step, uniform within its limits.

    The generator is counter-based: a chain of SplitMix64 finalisers over seed, env, step and joint, of whose result the
    upper 24 bits are the fraction. Any step of any environment can be made anywhere, in any order, on any device.

    name          of the topic
    joints        names, in the robot's order
    lower, upper  limits [rad]
    """

    name: str
    joints: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    def draw(self, seed: int, *, n_env: int, first_step: int, n_step: int) -> NDArray[np.float32]:
        """Targets [rad], shape [step, env, joint]; row i leads from the state of step first_step + i to the next."""
        counters = (
            np.arange(n_env)[None, :, None],
            first_step + np.arange(n_step)[:, None, None],
            np.arange(len(self.joints))[None, None, :],
        )
        word = mix(np.array([[[seed % 2**64]]], dtype=np.uint64) + np.uint64(GOLDEN))
        for counter in counters:
            word = mix(word + (counter.astype(np.uint64) + np.uint64(1)) * np.uint64(GOLDEN))
        fraction = (word >> np.uint64(64 - _MANTISSA)).astype(np.float64) / 2.0**_MANTISSA
        lower, upper = np.array(self.lower), np.array(self.upper)
        targets: NDArray[np.float32] = (lower + fraction * (upper - lower)).astype(np.float32)
        return targets
