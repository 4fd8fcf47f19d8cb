"""Bodies that fall from rest onto level ground, and the first bounce of a ball."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_FREE = 0.01  # share of g by which an acceleration in the air may be off
_OTHER = 0.25  # share of g beyond which a first step is no fall: no law claims to notice so large a change
_EPSILON = 2.0**-22  # of speeds that were recorded in float32, times two
_LONGEST = 0.3  # that a ball touches the ground before it leaves it; longer, it stays there [s]


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
        """The speed at the ground, sqrt(2 g h) [m/s]."""
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


@dataclass(frozen=True)
class Bounce:
    """The first contact of a ball, by the parabolas of the states in the air before and after it.

    time    of the contact [s]
    before  speed at which the ball meets the ground [m/s]
    after   speed at which it leaves it [m/s]; 0 where it stays

    All are NaN where no contact was recorded; `after` where the record ends during the contact.
    """

    time: float
    before: float
    after: float


def bounce(time: Array, height: Array, speed: Array, gravity: float) -> Bounce:
    """The first bounce.

    time     of the states [s], shape [row]
    height   of the lowest point above the ground [m], shape [row]
    speed    upward [m/s], shape [row]
    gravity  [m/s2]

    Between two states in the air, the speed falls by g times the time. A ball at height h with speed v meets the ground
    with sqrt(v^2 + 2 g h), and left it with the same. Where an engine pulls with another gravity than it was given, g
    is that of the first step, so that the time of the contact tells it.
    """
    lapse = np.diff(time)
    gravity = _pull(lapse, speed, gravity)
    off = np.abs(np.diff(speed) + gravity * lapse)
    free = off <= _FREE * gravity * lapse + _EPSILON * np.abs(speed[1:])
    touching = np.nonzero(~free)[0]
    if not len(touching) or touching[0] == 0:
        return Bounce(math.nan, math.nan, math.nan)
    last = int(touching[0])
    before = _at_ground(height[last], speed[last], gravity)
    contact = float(time[last] + (speed[last] + before) / gravity)
    leaving = np.nonzero(free[last:] & (speed[last:-1] > 0.0) & (height[last:-1] >= 0.0))[0]
    if len(leaving) and time[last + leaving[0]] - contact < _LONGEST:
        first = last + int(leaving[0])
        return Bounce(contact, before, _at_ground(height[first], speed[first], gravity))
    return Bounce(contact, before, 0.0 if time[-1] - contact > _LONGEST else math.nan)


def _pull(lapse: Array, speed: Array, gravity: float) -> float:
    """The acceleration of the fall, as of its first step where the ball clearly falls otherwise than it was told."""
    first = float((speed[0] - speed[1]) / lapse[0]) if len(lapse) else gravity
    return first if _FREE / 2.0 < abs(first / gravity - 1.0) < _OTHER else gravity


def _at_ground(height: float, speed: float, gravity: float) -> float:
    return math.sqrt(max(0.0, float(speed) ** 2 + 2.0 * gravity * float(height)))
