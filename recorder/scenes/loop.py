"""A planar loop of four links: the positions and speeds that close it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Loop:
    """A pin that closes a robot of four links in a plane, the stand counted: the crank and the rocker turn on the
    stand, the coupler on the crank, and the pin holds the end of the coupler on the end of the rocker.

    The three joints are the robot's, in the order crank, coupler, rocker; their axes are parallel, and at angle 0 the
    x axes of all four links are too. The frames of crank and rocker on the stand, that of the coupler on the crank, and
    both ends of the pin differ from each other along x, and along the axes alone.

    coupler, rocker        names of the two links that the pin joins
    on_coupler, on_rocker  where it is in their frames [m]
    speed                  of the crank at the start [rad/s]; the other joints follow
    """

    coupler: str
    rocker: str
    on_coupler: tuple[float, float, float]
    on_rocker: tuple[float, float, float]
    speed: float


@dataclass(frozen=True)
class FourBar:
    """Lengths of the links, from axis to axis [m]. The loop closes on the side where crank, coupler and rocker stand in
    this order against the clock; at no angle of the crank are coupler and rocker in line."""

    ground: float
    crank: float
    coupler: float
    rocker: float

    def angles(self, crank: ArrayLike) -> Array:
        """Angles of the three joints [rad], that of the coupler relative to the crank, shape [..., 3].

        crank  [rad], shape [...]

        The pin is where the circle of the coupler's end meets that of the rocker's: the law of cosines in the triangle
        of the coupler, the rocker and the diagonal from the crank's end to the rocker's axis.
        """
        turned = np.asarray(crank, dtype=np.float64)
        x, y = self.crank * np.cos(turned), self.crank * np.sin(turned)
        diagonal = np.hypot(self.ground - x, y)
        cosine = (diagonal**2 + self.coupler**2 - self.rocker**2) / (2.0 * diagonal * self.coupler)
        coupler = np.arctan2(-y, self.ground - x) + np.arccos(cosine)
        rocker = np.arctan2(y + self.coupler * np.sin(coupler), x + self.coupler * np.cos(coupler) - self.ground)
        return np.stack([turned, coupler - turned, rocker], axis=-1)

    def speeds(self, angles: Array, crank: ArrayLike) -> Array:
        """Speeds of the three joints that keep the loop closed [rad/s], shape [..., 3].

        angles  as of `angles`, shape [..., 3]
        crank   speed of the crank [rad/s], shape [...]

        The ends of coupler and rocker have one velocity: its parts along the rocker and along the coupler.
        """
        turned, coupler, rocker = angles[..., 0], angles[..., 0] + angles[..., 1], angles[..., 2]
        speed = np.asarray(crank, dtype=np.float64)
        across = self.crank * speed / np.sin(rocker - coupler)
        turning = across * np.sin(turned - rocker) / self.coupler
        return np.stack([speed, turning - speed, across * np.sin(turned - coupler) / self.rocker], axis=-1)
