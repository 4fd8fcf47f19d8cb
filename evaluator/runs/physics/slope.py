"""What a recording says of a ball that rolls down a slope, and of the friction of cubes that slide alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.rolling import Descent, Stretches, descent, foot_speed
from gpusimbench.evaluator.metrics.physics.solids import FixedBox, nearest, rotations
from gpusimbench.evaluator.metrics.physics.trend import FEWEST_ROWS, rounding, trend
from gpusimbench.evaluator.metrics.physics.vectors import largest, length
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import Check, Fact, Facts, measured
from gpusimbench.evaluator.runs.physics.setting import Setting
from gpusimbench.evaluator.runs.physics.states import States
from gpusimbench.evaluator.runs.physics.world import FixedBody

_CHECKS = (Check.ROLLING, Check.FOOT_SPEED, Check.SLIP)
_MOST_ROWS = 1 << 14  # until the foot; a step so short that there are more is no simulator's

_LEVEL = float(np.cos(np.radians(2.0)))  # of a face, to count as flat on the ground
_HOVER = 1e-3  # between the heights of a cube that slides and of one that lies [m]
_SPIN = 0.3  # speed of a corner about the centre over the speed, to count as sliding straight
_SHARE = 0.05  # of the coefficient: a spin of 30 % takes 2 %, a tilt of 2 degrees lifts it for a while

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def slope_facts(setting: Setting) -> Facts:
    """Acceleration, speed at the foot, and slip of the first ball that starts at rest on a slope."""
    found = _find(setting)
    if isinstance(found, Missing):
        return dict.fromkeys(_CHECKS, found)
    ball, way = found
    before = int(way.duration / setting.row_time) + 2
    rows = len(setting.walk)
    last = int(way.window[1] / setting.row_time)
    if before > _MOST_ROWS:
        return dict.fromkeys(_CHECKS, Missing(f"more than {_MOST_ROWS} rows until the foot"))
    if rows <= last:
        return dict.fromkeys(_CHECKS, Missing("the states end before the foot of the slope"))
    states = setting.walk.rows(0, min(before + before // 2, rows))
    time = states.step * setting.dt
    window = (time >= way.window[0]) & (time <= way.window[1])
    if np.count_nonzero(window) < FEWEST_ROWS:
        why = f"fewer than {FEWEST_ROWS} rows are on the slope"
        return dict.fromkeys(_CHECKS, Missing(why))
    along = way.travelled(states.position[:, :, ball])
    fit = trend(time[window], along[window])
    drift = rounding(
        last * setting.stride, setting.dt, largest_place=1.0 + setting.walk.offset, largest_speed=way.foot_speed,
        epsilon=setting.walk.epsilon,
    )  # fmt: skip
    share = setting.dt / way.duration
    rolling = {
        Check.ROLLING: measured(
            fit.acceleration, low=way.acceleration, high=way.acceleration,
            tolerance=way.acceleration * share + fit.gain * drift, of="a dt / T, and rounding",
        )
    }  # fmt: skip
    if states.linear is None or states.angular is None:
        return {**rolling, **dict.fromkeys((Check.FOOT_SPEED, Check.SLIP), Missing("velocities were not recorded"))}
    linear, angular = states.linear[:, :, ball], states.angular[:, :, ball]
    return {
        **rolling,
        Check.FOOT_SPEED: measured(
            foot_speed(along, linear @ way.downhill, way.length), low=way.foot_speed,
            high=way.foot_speed, tolerance=way.foot_speed * share, of="v dt / T",
        ),
        Check.SLIP: measured(
            way.slip(linear[window], angular[window]).max(axis=0), tolerance=way.steepest * setting.dt,
            of="g sin(angle) dt",
        ),
    }  # fmt: skip


def _find(setting: Setting) -> tuple[int, Descent] | Missing:
    if (otherwise := setting.begun_otherwise) is not None:
        return otherwise
    for index, body in enumerate(setting.world.moving):
        if not (body.radius and body.rests):
            continue
        for fixed in setting.world.fixed:
            if fixed.level or not isinstance(fixed.solid, FixedBox):
                continue
            way = descent(fixed.solid, np.array(body.start), body.radius, setting.world.gravity)
            if way is None:
                continue
            friction = min(body.surface.kinetic, fixed.surface.kinetic)
            if friction <= way.enough:
                return Missing(f"friction may be too low for rolling: {friction:g}, and {way.enough:.3g} is needed")
            return index, way
    return Missing("no ball starts at rest on a slope")


class Slides:
    """Collects stretches in which a cube slides."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        bodies = setting.world.moving
        self._cubes = [i for i, body in enumerate(bodies) if body.half]
        self._reach = np.array([body.reach for body in bodies])
        self._half = np.array([bodies[i].half for i in self._cubes])
        self._floors = setting.world.floors
        pairs = [(bodies[i].surface.kinetic, floor.surface.kinetic) for i in self._cubes for floor in self._floors]
        self._bounds = min((min(pair) for pair in pairs), default=0.0), max((max(pair) for pair in pairs), default=0.0)
        self._stretches: Stretches | None = None

    def feed(self, states: States) -> None:
        """The next rows."""
        if states.linear is None or states.angular is None or states.orientation is None or not self._cubes:
            return
        if self._setting.sparse:
            return
        envs, bodies = states.position.shape[1:3]
        linear = states.linear[:, :, self._cubes]
        slides = self._candidates(states, linear)
        row, env = np.nonzero(slides.any(axis=2))
        if len(row):
            closest, _ = nearest(states.position[row, env])
            slides[row, env] &= closest[:, self._cubes] > self._reach[self._cubes] + self._reach.max()
            which = np.nonzero(slides)
            turn = rotations(states.orientation[:, :, self._cubes][which])
            slides[which] &= np.abs(turn[:, 2]).max(axis=-1) > _LEVEL
        if self._stretches is None:
            gravity, dt = self._setting.world.gravity, self._setting.dt
            self._stretches = Stretches(envs * len(self._cubes), gravity=gravity, dt=dt)
        for index in range(len(slides)):
            self._stretches.feed(linear[index].reshape(-1, 3), slides[index].reshape(-1))

    def fact(self) -> Fact:
        """The coefficient, once all rows were fed."""
        if self._setting.sparse:
            return Missing(self._setting.sparse)
        if not self._floors or not self._cubes:
            return Missing("no cube can slide on level ground")
        if self._stretches is not None:
            self._stretches.end()
        found = self._stretches.friction if self._stretches else []
        if not found:
            return Missing(f"no cube slid flat, straight and apart from all others for {FEWEST_ROWS} rows")
        low, high = self._bounds
        return measured(
            found, low=low, high=high, tolerance=_SHARE * high, of="5 % of the larger coefficient",
            note=f"{len(found)} stretches; the rule for a pair is not part of the scene",
        )  # fmt: skip

    def _candidates(self, states: States, linear: Array) -> Mask:
        # fast enough, straight enough, at the right height; what is dear to know comes after
        assert states.angular is not None
        speed = length(linear[..., :2])
        spin = length(states.angular[:, :, self._cubes]) * self._reach[self._cubes]
        fast = speed > self._bounds[1] * self._setting.world.gravity * self._setting.dt
        return np.asarray(fast & (spin < _SPIN * speed) & self._on_a_floor(states.position[:, :, self._cubes]))

    def _on_a_floor(self, place: npt.NDArray[np.float64]) -> Mask:
        found = np.zeros(place.shape[:3], dtype=bool)
        for floor in self._floors:
            found |= self._lies_on(floor, place)
        return found

    def _lies_on(self, floor: FixedBody, place: npt.NDArray[np.float64]) -> Mask:
        near = np.abs(place[..., 2] - floor.top - self._half) < _HOVER
        if isinstance(floor.solid, FixedBox):
            near &= largest(np.abs(floor.solid.local(place)[..., :2]) - floor.solid.half[:2]) < 0
        return np.asarray(near)
