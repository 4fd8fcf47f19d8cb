"""Closed forms of mechanics, as pure functions of a scene's parameters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import ellipkm1

Array = npt.NDArray[np.float64]


def pendulum_period(amplitude: Array, small: float) -> Array:
    """Period of a physical pendulum that is released at rest [s].

    amplitude  angle from the lowest position [rad], below pi
    small      period of small swings, 2 pi sqrt(I / (m g l)) [s]

    T = T0 2/pi K(sin(a/2)), with the complete elliptic integral of the first kind (Landau and Lifshitz, Mechanics,
    section 11, problem 1).
    """
    return np.asarray(small * 2.0 / np.pi * ellipkm1(np.cos(np.asarray(amplitude) / 2.0) ** 2))


def sliding_acceleration(along: float, normal: float, gravity: float, friction: float) -> float:
    """Of a block that slides down a plank by Coulomb's law [m/s2]: g (sin a - mu cos a).

    along   component of the unit vector along the motion that points down: sin a
    normal  component of the plank's normal that points up: cos a
    """
    return gravity * (along - friction * normal)


def stopping_distance(speed: Array, acceleration: float) -> Array:
    """v^2 / (2 d) [m], of a block that brakes with `acceleration` = -d [m/s2] from `speed` [m/s]."""
    return np.asarray(speed**2 / (-2.0 * acceleration))
