"""Bodies that fall from rest onto level ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Fall:
    """A fall from rest through a height, without air.

    height   of the lowest point above the ground [m]
    gravity  [m/s2]
    """

    height: float
    gravity: float

    @property
    def duration(self) -> float:
        """Until the ground, sqrt(2 h / g) [s]."""
        return math.sqrt(2.0 * self.height / self.gravity)

    @property
    def speed(self) -> float:
        """At the ground, sqrt(2 g h) [m/s]."""
        return math.sqrt(2.0 * self.gravity * self.height)


@dataclass(frozen=True)
class Impact:
    """The first impact, shape [env].

    time     of the row with the largest speed downward [s]
    speed    that speed [m/s]
    rebound  largest speed upward of all bodies' centre of mass after it, over the speed of impact
    """

    time: Array
    speed: Array
    rebound: Array


def impact(time: Array, lowest: Array, together: Array) -> Impact:
    """Find the first impact in rows around it.

    time      [s], shape [row]
    lowest    vertical velocity of the bodies that fall in front, their mean [m/s], shape [row, env]
    together  vertical velocity of the centre of mass [m/s], shape [row, env]
    """
    at = lowest.argmin(axis=0)
    speed = -lowest[at, np.arange(lowest.shape[1])]
    after = np.arange(len(time))[:, None] > at
    up = np.where(after, together, 0.0).max(axis=0)
    return Impact(time[at], speed, np.asarray(up / np.where(speed > 0, speed, np.nan)))


def deformation(position: Array) -> Array:
    """Largest displacement of any body against the mean of all since the first row [m], shape [env].

    position  [m], shape [row, env, body, 3]
    """
    moved = position - position[0]
    against = np.linalg.norm(moved - moved.mean(axis=2, keepdims=True), axis=-1)
    return np.asarray(against.max(axis=(0, 2)))
