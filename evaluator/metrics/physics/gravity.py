"""Bodies that gravity moves: they fall from rest onto level ground, roll down a slope, or slide and come to rest; and
constant acceleration, fitted to places on a line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.solids import FixedBox

Array = npt.NDArray[np.float64]

_FREE = 0.01  # share of g by which an acceleration in the air may be off
_OTHER = 0.25  # share of g beyond which a first step is no fall: no law claims to notice so large a change
_EPSILON = 2.0**-22  # of speeds that were recorded in float32, times two
_LONGEST = 0.3  # that a ball touches the ground before it leaves it; longer, it stays there [s]

FEWEST_ROWS = 5

_TOUCHING = 1e-3  # of a ball that lies on the slope [m]
_WINDOW = (0.1, 0.9)  # of the way: the start may shake, and the foot comes early where a method runs ahead


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


@dataclass(frozen=True)
class Trend:
    """The parabola  x(t) = c0 + lead t + acceleration t^2 / 2  of least squares.

    An Euler method of step dt puts a body that starts at rest at a t^2 / 2 + a t dt / 2 (semi-implicit) or
    a t^2 / 2 - a t dt / 2 (explicit) at its steps, exactly. The first-order error is all in `lead`, so `acceleration`
    is a for either of them, and lead / (a dt) tells which it was.

    acceleration  [m/s2], shape of one row
    lead          [m/s], the same shape
    gain          error of the acceleration for an error of at most 1 m in any of the places [1/s2]
    """

    acceleration: Array
    lead: Array
    gain: float


def trend(time: Array, place: Array) -> Trend:
    """Fit places [m], shape [row, ...], at times [s], shape [row]; ValueError with fewer than FEWEST_ROWS rows."""
    if len(time) < FEWEST_ROWS:
        raise ValueError(f"{len(time)} rows are too few for a fit")
    scale = float(np.abs(time).max())
    share = time / scale
    weights = np.linalg.pinv(np.stack([np.ones_like(share), share, share**2 / 2], axis=1))
    _, lead, acceleration = np.tensordot(weights, place, axes=(1, 0))
    gain = float(np.abs(weights[2]).sum()) / scale**2
    return Trend(acceleration / scale**2, lead / scale, gain)


def rounding(steps: int, dt: float, *, largest_place: float, largest_speed: float, epsilon: float) -> float:
    """How far rounding alone can carry a body in a number of steps [m].

    Every step rounds the place and the speed once, by half a unit in the last place at most; an error of the speed
    moves every later place.

    epsilon  of the engine's type: 2^-23 for float32, 2^-52 for float64
    """
    return epsilon / 2 * (steps * largest_place + steps**2 / 2 * dt * largest_speed)


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
