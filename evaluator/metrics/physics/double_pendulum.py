"""A planar double pendulum of two rigid bodies: energy, and normal modes of small vibrations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class DoublePendulum:
    """Two rigid bodies, the upper on a fixed level axis, the lower on a parallel axis of the upper.

    mass     of the upper and the lower body [kg]
    inertia  of each about its own joint's axis [kg m2]
    centre   distance of each centre of mass from its own joint's axis [m]
    apart    distance of the two axes [m]; the upper centre lies on the line between them
    gravity  [m/s2]
    """

    mass: tuple[float, float]
    inertia: tuple[float, float]
    centre: tuple[float, float]
    apart: float
    gravity: float

    @property
    def coupling(self) -> float:
        """m2 d l2 [kg m2]."""
        return self.mass[1] * self.apart * self.centre[1]

    @property
    def weights(self) -> tuple[float, float]:
        """Largest torques of gravity on the two angles from the vertical [N m]."""
        upper = self.gravity * (self.mass[0] * self.centre[0] + self.mass[1] * self.apart)
        return upper, self.gravity * self.mass[1] * self.centre[1]

    def energy(self, angle: Array, speed: Array) -> Array:
        """Kinetic and potential energy, above the lowest position [J], shape [...].

        angle  from the vertical [rad], shape [..., 2]
        speed  of these [rad/s], shape [..., 2]

        (Landau and Lifshitz, Mechanics, section 5, problem 1, for rigid bodies instead of points.)
        """
        first = self.inertia[0] + self.mass[1] * self.apart**2
        turning = 0.5 * (first * speed[..., 0] ** 2 + self.inertia[1] * speed[..., 1] ** 2)
        turning += self.coupling * np.cos(angle[..., 0] - angle[..., 1]) * speed[..., 0] * speed[..., 1]
        # 1 - cos a without the loss of a difference
        return np.asarray(turning + (2.0 * np.sin(angle / 2.0) ** 2) @ np.array(self.weights))

    def modes(self) -> tuple[Array, Array]:
        """Angular frequencies of small vibrations [rad/s], slower first, shape [2], and the matrix [2, 2] whose row i
        takes the angles from the vertical to the coordinate of mode i.

        The roots of det(K - w^2 M) = 0 (Landau and Lifshitz, Mechanics, section 23).
        """
        from scipy.linalg import eigh

        inertia = np.array(
            [
                [self.inertia[0] + self.mass[1] * self.apart**2, self.coupling],
                [self.coupling, self.inertia[1]],
            ]
        )
        squared, shapes = eigh(np.diag(self.weights), inertia)
        return np.sqrt(squared), np.asarray(shapes.T @ inertia)
