"""A ball that rolls down a slope from rest, and friction of bodies that slide over level ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.solids import FixedBox
from gpusimbench.evaluator.metrics.physics.trend import FEWEST_ROWS

Array = npt.NDArray[np.float64]

_TOUCHING = 1e-3  # of a ball that lies on the slope [m]
_WINDOW = (0.1, 0.9)  # of the way: the start may shake, and the foot comes early where a method runs ahead


@dataclass(frozen=True)
class Descent:
    """A solid ball on a plane slope, from rest to the foot, rolling without slipping.

    The contact point has no velocity, so the friction force F and the ball's moment of inertia 2/5 m r^2 give
    m a = m g sin(angle) - F and 2/5 m r a = F r, hence a = 5/7 g sin(angle), for which a coefficient of friction of
    2/7 tan(angle) is enough.

    start    of the ball's centre [m], shape [3]
    downhill unit vector, shape [3]
    normal   of the slope, out of it, unit vector, shape [3]
    radius   of the ball [m]
    length   along the slope to where its edge is beneath the ball [m]
    steepest g sin(angle) [m/s2]
    enough   coefficient of friction that rolling needs
    """

    start: Array
    downhill: Array
    normal: Array
    radius: float
    length: float
    steepest: float
    enough: float

    @property
    def acceleration(self) -> float:
        """The acceleration of the ball [m/s2]."""
        return 5.0 / 7.0 * self.steepest

    @property
    def duration(self) -> float:
        """Until the foot [s]."""
        return math.sqrt(2.0 * self.length / self.acceleration)

    @property
    def foot_speed(self) -> float:
        """The speed at the foot, sqrt(2 a length) [m/s]."""
        return math.sqrt(2.0 * self.acceleration * self.length)

    @property
    def window(self) -> tuple[float, float]:
        """Times between which the ball is between 10 % and 90 % of the way [s]."""
        low, high = (math.sqrt(share) * self.duration for share in _WINDOW)
        return low, high

    def travelled(self, position: Array) -> Array:
        """The way along the slope [m], shape [...], of positions [m], [..., 3]."""
        return np.asarray((position - self.start) @ self.downhill)

    def slip(self, linear: Array, angular: Array) -> Array:
        """Speed of the ball's contact point in the plane of the slope [m/s], shape [...].

        linear, angular  of the ball, world frame [m/s], [rad/s], shape [..., 3]
        """
        at_contact = linear + np.cross(angular, -self.radius * self.normal)
        in_plane = at_contact - (at_contact @ self.normal)[..., None] * self.normal
        return np.asarray(np.linalg.norm(in_plane, axis=-1))


def descent(slope: FixedBox, start: Array, radius: float, gravity: float) -> Descent | None:
    """The way of a ball at rest down a fixed box; None where it does not lie on an inclined face of it.

    gravity  magnitude, along -z [m/s2]
    """
    normal = slope.rotation[:, 2]
    if not 1e-3 < normal[2] < 1.0 - 1e-9:
        return None
    local = slope.local(start)
    lies = abs(local[2] - slope.half[2] - radius) <= _TOUCHING and (np.abs(local[:2]) <= slope.half[:2]).all()
    if not lies:
        return None
    pull = np.array([0.0, 0.0, -1.0]) + normal[2] * normal
    sine = float(np.linalg.norm(pull))
    downhill = pull / sine
    direction = downhill @ slope.rotation
    toward = np.abs(direction[:2]) > 1e-9
    ways = (np.sign(direction[:2]) * slope.half[:2] - local[:2])[toward] / direction[:2][toward]
    length = float(ways.min())
    if length <= radius:
        return None
    return Descent(
        start, downhill, normal, radius, length, gravity * sine, 2.0 / 7.0 * sine / float(normal[2])
    )  # fmt: skip


def foot_speed(way: Array, speed: Array, length: float) -> Array:
    """Speed at the foot [m/s], shape [env], from the last row before it; NaN where no row is in its last half.

    v^2 = 2 a s carries the speed at s on to the foot: v sqrt(length / s).

    way, speed  along the slope [m], [m/s], shape [row, env]
    """
    before = (np.maximum.accumulate(way, axis=0) < length) & (way > length / 2)
    last = np.where(before.any(axis=0), len(way) - 1 - before[::-1].argmax(axis=0), 0)
    env = np.arange(way.shape[1])
    found, at = speed[last, env], way[last, env]
    reached = before[last, env]
    return np.asarray(np.where(reached, found * np.sqrt(length / np.where(reached, at, 1.0)), np.nan))


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
