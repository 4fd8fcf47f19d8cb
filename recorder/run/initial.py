"""Initial states of environments that do not all begin alike."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.snapshot import Extent
from gpusimbench.schemas.configuration import MOST_SPREAD, spread_of
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.mix32 import GOLDEN32, mix32

GRID = 2.0**-13
"""What is added is a whole multiple of this [m/s or rad], so that the sum with zero is exact in either precision."""

_STREAM = 0x494E4954  # tells these words from those of actions, which the same seed draws


@dataclass(frozen=True)
class Spread:
    """Adds to the scene's first state, uniformly within +- spread and independently for each environment:

        to the linear velocity of every free body, along each axis [m/s]
        to the angle of every joint [rad], kept within its limits

    No body is moved, so that none penetrates another. The generator is counter-based, in 32-bit wrapping integers:

        w = mix(mix(mix(seed_low + G) + seed_high + G) + stream)
        w = mix(w + (field + 1) * G), and the same with env, item and component
        added = ((w >> 16) * (2 k + 1) >> 16) - k, times GRID, with k = floor(spread / GRID)

    with mix the finaliser of MurmurHash3, G = 0x9E3779B9 (``schemas.mix32``), stream 0x494E4954, and `field` the place
    of the field in the layout of the state.
    """

    spread: float

    def states(self, scene: Scene, fields: tuple[StateField, ...], first: States, seed: int) -> States:
        """The first state [env, item, width] of each field with what is added, in the field's precision."""
        return tuple(
            self._added(scene, place, layout, array, seed)
            for place, (layout, array) in enumerate(zip(fields, first, strict=True))
        )

    def _added(
        self, scene: Scene, place: int, layout: StateField, array: NDArray[np.floating], seed: int
    ) -> NDArray[np.floating]:
        if layout.field not in ("linear_velocity", "qpos"):
            return array.copy()
        found = np.asarray(array + self.draw(seed, place, array.shape).astype(array.dtype))
        if layout.field == "qpos" and scene.robot is not None:
            limits = np.array([(joint.lower, joint.upper) for joint in scene.robot.joints()], dtype=array.dtype)
            found = np.clip(found, limits[:, :1], limits[:, 1:])
        return found.astype(array.dtype)

    def draw(self, seed: int, field: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """What is added to a field of this shape [env, item, width]."""
        golden, most = np.uint32(GOLDEN32), math.floor(self.spread / GRID)
        word = np.array([seed & 0xFFFFFFFF], dtype=np.uint32)
        word = mix32(mix32(mix32(word + golden) + np.uint32((seed >> 32) & 0xFFFFFFFF) + golden) + np.uint32(_STREAM))
        word = mix32(word + np.array([field + 1], dtype=np.uint32) * golden).reshape((1,) * len(shape))
        for axis, count in enumerate(shape):
            others = [other for other in range(len(shape)) if other != axis]
            word = mix32(word + np.expand_dims(np.arange(1, count + 1, dtype=np.uint32), others) * golden)
        index = (word >> np.uint32(16)) * np.uint32(2 * most + 1) >> np.uint32(16)
        return np.asarray((index.astype(np.int64) - most) * GRID, dtype=np.float64)


def begin(simulator: Simulator, description: Description, initial: str) -> None:
    """Give a simulator that was just built the initial states that a run was asked to have."""
    if initial:
        first = tuple(np.array(array) for array in simulator.state())
        given = Spread(spread_of(initial)).states(simulator.scene, description.fields, first, simulator.seed)
        simulator.set_state(given)


def refusal(name: str, adapter: type[Simulator], options: object, initial: str) -> str:
    """Why a simulator cannot begin so; empty where it can."""
    claim = adapter.state_claims(options).set_state
    if not initial or claim.extent is not Extent.NONE:
        return ""
    return f"simulator '{name}' has no initial states per environment (--initial): {claim.why}"


def parse(text: str) -> str:
    """What --initial was given, as the recording keeps it. UsageError where it is nothing that can be drawn."""
    kind, _, number = text.partition(":")
    try:
        spread = float(number)
    except ValueError:
        spread = math.nan
    if kind != "random" or not GRID <= spread <= MOST_SPREAD:
        raise UsageError(
            f"--initial is random:SPREAD, with a spread from {GRID:.2g} to {MOST_SPREAD:g} (of velocities in m/s, of "
            f"joint angles in rad), not '{text}'"
        )
    return f"random:{spread!r}"
