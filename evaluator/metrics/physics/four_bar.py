"""A planar four-bar linkage of rigid links: Freudenstein's equation, the gap of its loop, energy and period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_TURN: Array = np.arange(720, dtype=np.float64) * (
    2.0 * np.pi / 720.0
)  # of the crank: so many that a turn's integral errs by rounding alone


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
