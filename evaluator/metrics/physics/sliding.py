"""Friction of single bodies that slide over level ground."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FEWEST_ROWS = 5


class Stretches:
    """Follows bodies that slide, and measures friction over each stretch of at least FEWEST_ROWS rows.

    By the impulses of the stretch, so that a body that hops a little counts with the force that it had:

        mu = (|v_0| - |v_n|) / (g t + w_n - w_0),   v in the plane, w upward

    A stretch in which the ground bore less than half of the weight is no sliding.

    friction  a coefficient for each stretch that has ended
    """

    def __init__(self, bodies: int, *, gravity: float, dt: float) -> None:
        """dt: of a row [s]."""
        self._gravity, self._dt = gravity, dt
        self._length = np.zeros(bodies, dtype=np.int64)
        self._first = np.zeros((bodies, 3))
        self._last = np.zeros((bodies, 3))
        self.friction: list[float] = []

    def feed(self, velocity: Array, slides: npt.NDArray[np.bool_]) -> None:
        """The next row: velocities [m/s], shape [body, 3], and which bodies slide, shape [body]."""
        self._close(~slides)
        begins = slides & (self._length == 0)
        self._first[begins] = velocity[begins]
        self._last[slides] = velocity[slides]
        self._length = np.where(slides, self._length + 1, 0)

    def end(self) -> None:
        """After the last row."""
        self._close(np.ones(len(self._length), dtype=bool))
        self._length[:] = 0

    def _close(self, ended: npt.NDArray[np.bool_]) -> None:
        long = ended & (self._length >= FEWEST_ROWS)
        if not long.any():
            return
        first, last = self._first[long], self._last[long]
        weight = self._gravity * (self._length[long] - 1) * self._dt
        lost = np.linalg.norm(first[:, :2], axis=-1) - np.linalg.norm(last[:, :2], axis=-1)
        borne = weight + last[:, 2] - first[:, 2]
        good = borne > weight / 2
        self.friction += (lost[good] / borne[good]).tolist()
