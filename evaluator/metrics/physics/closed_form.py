"""Closed forms of mechanics, as pure functions of a scene's parameters; energy and modes of a double pendulum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def pendulum_period(amplitude: Array, small: float) -> Array:
    """Period of a physical pendulum that is released at rest [s].

    amplitude  angle from the lowest position [rad], of either sign, its size below pi
    small      period of small swings, 2 pi sqrt(I / (m g l)) [s]

    T = T0 2/pi K(sin(a/2)), with the complete elliptic integral of the first kind (Landau and Lifshitz, Mechanics,
    section 11, problem 1).
    """
    from scipy.special import ellipkm1

    return np.asarray(small * 2.0 / np.pi * ellipkm1(np.cos(np.asarray(amplitude) / 2.0) ** 2))


def sliding_acceleration(along: float, normal: float, gravity: float, friction: float) -> float:
    """The acceleration of a block that slides down a plank by Coulomb's law [m/s2]: g (sin a - mu cos a).

    along   component of the unit vector along the motion that points down: sin a
    normal  component of the plank's normal that points up: cos a
    """
    return gravity * (along - friction * normal)


def stopping_distance(speed: Array, acceleration: float) -> Array:
    """v^2 / (2 d) [m], of a block that brakes with `acceleration` = -d [m/s2] from `speed` [m/s]."""
    return np.asarray(speed**2 / (-2.0 * acceleration))


def rotation_period(moments: Array, spin: Array) -> Array:
    """Period of a free body's angular velocity in its own axes [s], shape [...]; infinite on the separatrix.

    moments  principal moments I1 < I2 < I3 [kg m2], shape [3]
    spin     angular velocity about these axes at any time [rad/s], shape [..., 3]

    T = 4 K(k) sqrt(I1 I2 I3 / ((I3 - I2) (L^2 - 2 E I1))), k^2 = (I2 - I1) (2 E I3 - L^2) / ((I3 - I2) (L^2 - 2 E I1)),
    with the energy E, the angular momentum L and the complete elliptic integral of the first kind K, for L^2 > 2 E I2;
    else the same with I1 and I3 exchanged (Landau and Lifshitz, Mechanics, section 37; Goldstein, Classical Mechanics,
    section 5.6). The component about the middle axis, an elliptic sine, passes zero twice in a period.
    """
    from scipy.special import ellipkm1

    i1, i2, i3 = moments
    twice_energy, squared = (spin**2 @ moments), (spin**2 @ moments**2)
    inner, outer = (i3 - i2) * (squared - twice_energy * i1), (i2 - i1) * (twice_energy * i3 - squared)
    larger = np.maximum(inner, outer)
    complement = (i3 - i1) * np.abs(squared - twice_energy * i2) / larger  # 1 - k^2, without the loss of a difference
    return np.asarray(4.0 * ellipkm1(complement) * np.sqrt(i1 * i2 * i3 / larger))


def falling_time(height: Array, speed: Array, gravity: float) -> Array:
    """Until a body that is thrown upward with `speed` [m/s] from `height` [m] has fallen to zero [s]."""
    return np.asarray((speed + np.sqrt(speed**2 + 2.0 * gravity * height)) / gravity)


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
