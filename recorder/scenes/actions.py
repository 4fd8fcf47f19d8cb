"""Actions that every engine is given: a pure function of seed, step and environment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MANTISSA = 24  # bits of a float32: every engine gets exactly the same number


def _mix(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(word ^ (word >> np.uint64(31)))


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
        with np.errstate(over="ignore"):
            word = _mix(np.full((1, 1, 1), np.uint64(seed % 2**64)) + _GOLDEN)
            for axis, counter in enumerate(
                (np.arange(n_env), first_step + np.arange(n_step), np.arange(len(self.joints)))
            ):
                shape = [1, 1, 1]
                shape[(1, 0, 2)[axis]] = -1
                word = _mix(word + (counter.astype(np.uint64).reshape(shape) + np.uint64(1)) * _GOLDEN)
        fraction = (word >> np.uint64(64 - _MANTISSA)).astype(np.float64) / 2.0**_MANTISSA
        lower, upper = np.array(self.lower), np.array(self.upper)
        targets: NDArray[np.float32] = (lower + fraction * (upper - lower)).astype(np.float32)
        return targets
