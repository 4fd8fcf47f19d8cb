"""Whether places follow from velocities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.vectors import length

Array = npt.NDArray[np.float64]


class Displacements:
    """Follows how far bodies moved beyond what their velocities account for.

        beyond = |x(k+1) - x(k) - (v(k) + v(k+1)) dt / 2| - |v(k+1) - v(k)| dt / 2

    A one-step method of whatever order moves a body by a mean of velocities between those of the two rows, which makes
    `beyond` zero or less. What is left is a correction of positions that no velocity tells.

    largest  [m], shape [env]
    """

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._before: tuple[Array, Array] | None = None
        self.largest = np.zeros(0)

    def feed(self, position: Array, velocity: Array) -> None:
        """The next rows [m], [m/s], shape [row, env, body, 3]."""
        if self._before is None:
            self.largest = np.full(position.shape[1], -np.inf)
        else:
            position = np.concatenate([self._before[0][None], position])
            velocity = np.concatenate([self._before[1][None], velocity])
        self._before = position[-1], velocity[-1]
        half = self._dt / 2.0
        moved = np.diff(position, axis=0) - (velocity[1:] + velocity[:-1]) * half
        beyond = length(moved) - length(np.diff(velocity, axis=0)) * half
        self.largest = np.maximum(self.largest, beyond.max(axis=(0, 2), initial=-np.inf))
