"""Closed forms of mechanics, as pure functions of a scene's parameters; energy and modes of a double pendulum; and a
planar four-bar linkage: Freudenstein's equation, the gap of its loop, energy and period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# of the crank: so many that a turn's integral errs by rounding alone
_TURN: Array = np.arange(720, dtype=np.float64) * (2.0 * np.pi / 720.0)


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


@dataclass(frozen=True)
class FourBar:
    """A crank and a rocker on fixed parallel axes, and a coupler from the crank's end to the rocker's.

    ground, crank, coupler, rocker  lengths of the links, from axis to axis [m]
    inertia                         of crank, coupler and rocker about their own first axis, which for the coupler is
                                    the one on the crank [kg m2]
    mass                            of the coupler [kg]
    centre                          distance of the coupler's centre of mass from the crank's end, on the line to the
                                    rocker's end [m]

    Angles are those from the ground to each link against the clock. Of the two ways to assemble the links, the one is
    meant in which the crank's end, the rocker's end and the rocker's axis follow each other with the clock.
    """

    ground: float
    crank: float
    coupler: float
    rocker: float
    inertia: tuple[float, float, float]
    mass: float
    centre: float

    def turns(self) -> bool:
        """Whether the crank can turn all the way round: it is the shortest link, and with the longest shorter than the
        other two together (Grashof), by 1 % at least, so that coupler and rocker are never in line."""
        lengths = sorted((self.ground, self.crank, self.coupler, self.rocker))
        return self.crank < lengths[1] and lengths[0] + lengths[3] <= 0.99 * (lengths[1] + lengths[2])

    def angles(self, crank: Array) -> tuple[Array, Array]:
        """Angles of coupler and rocker [rad] for angles of the crank [rad], each of shape [...].

        Freudenstein's equation K1 cos r - K2 cos a + K3 = cos(a - r) of the crank's angle a and the rocker's r, and
        its counterpart for the coupler, are quadratic in the tangent of half the angle (Freudenstein, An analytical
        approach to the design of four-link mechanisms, Transactions of the ASME 76, 1954; Norton, Design of Machinery,
        section 4.5). Lengths must be those of links that can be assembled at all of these angles.
        """
        d, a, b, c = self.ground, self.crank, self.coupler, self.rocker
        cosine, sine = np.cos(crank), np.sin(crank)
        rocker = _root(
            cosine - d / a - d / c * cosine + (a * a - b * b + c * c + d * d) / (2.0 * a * c),
            -2.0 * sine,
            d / a - (d / c + 1.0) * cosine + (a * a - b * b + c * c + d * d) / (2.0 * a * c),
        )
        coupler = _root(
            cosine - d / a + d / b * cosine + (c * c - d * d - a * a - b * b) / (2.0 * a * b),
            -2.0 * sine,
            d / a + (d / b - 1.0) * cosine + (c * c - d * d - a * a - b * b) / (2.0 * a * b),
        )
        return coupler, rocker

    def gap(self, crank: Array, coupler: Array, rocker: Array) -> Array:
        """Distance between the ends of coupler and rocker [m], from angles [rad] of one shape."""
        x = self.crank * np.cos(crank) + self.coupler * np.cos(coupler) - self.ground - self.rocker * np.cos(rocker)
        y = self.crank * np.sin(crank) + self.coupler * np.sin(coupler) - self.rocker * np.sin(rocker)
        return np.asarray(np.hypot(x, y))

    def energy(self, between: Array, crank: Array, coupler: Array, rocker: Array) -> Array:
        """Kinetic energy [J].

        between                angle from crank to coupler [rad], shape [...]
        crank, coupler, rocker  angular velocities of the links [rad/s], shape [...]

        That of the coupler is m a^2 u^2 / 2 + I w^2 / 2 + m a s u w cos(angle) by König's theorem, with its centre of
        mass at s from the crank's end.
        """
        first, second, third = self.inertia
        turning = (first + self.mass * self.crank**2) * crank**2 + second * coupler**2 + third * rocker**2
        return np.asarray(turning / 2.0 + self.mass * self.crank * self.centre * crank * coupler * np.cos(between))

    def period(self, energy: Array) -> Array:
        """Time of a turn of the crank with this kinetic energy [s], shape [...], where no force does work.

        With the energy I(a) u^2 / 2 of a closed loop at crank angle a and speed u, the turn takes the integral of
        sqrt(I(a) / (2 E)) over a: by the trapezoidal rule, which for periodic functions converges geometrically.
        """
        return np.asarray(2.0 * np.pi * np.sqrt(self._unit(_TURN)[0]).mean() / np.sqrt(energy))

    def energy_at(self, crank: Array, speed: Array) -> Array:
        """Kinetic energy of the closed loop [J], from angle [rad] and speed [rad/s] of the crank, shape [...]."""
        return np.asarray(self._unit(crank)[0] * speed**2)

    def towards_axes(self, energy: Array) -> Array:
        """Largest sum of length times squared angular velocity of crank, coupler and rocker in a turn with this kinetic
        energy [m/s2], shape [...]: by how much two ends that move on straight on part from each other is up to half of
        it times the time squared."""
        unit, speeds = self._unit(_TURN)
        sums = (speeds**2) @ np.array([self.crank, self.coupler, self.rocker]) / unit
        return np.asarray(sums.max() * energy)

    def _unit(self, crank: Array) -> tuple[Array, Array]:
        """Energy [J], shape [...], and angular velocities of the links [rad/s], shape [..., 3], with a crank of
        1 rad/s: coupler and rocker give their common end one velocity."""
        coupler, rocker = self.angles(crank)
        across = self.crank / np.sin(rocker - coupler)
        turning = across * np.sin(crank - rocker) / self.coupler
        swinging = across * np.sin(crank - coupler) / self.rocker
        speeds = np.stack([np.ones_like(crank), turning, swinging], axis=-1)
        return self.energy(coupler - crank, *np.moveaxis(speeds, -1, 0)), speeds


def _root(a: Array, b: Array, c: Array) -> Array:
    """The angle from -pi to pi whose half has the tangent (-b - sqrt(b^2 - 4 a c)) / 2 a."""
    return wrapped(2.0 * np.arctan2(-b - np.sqrt(b * b - 4.0 * a * c), 2.0 * a))


def wrapped(angle: Array) -> Array:
    """The same direction, from -pi to pi [rad]."""
    return np.asarray(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)
