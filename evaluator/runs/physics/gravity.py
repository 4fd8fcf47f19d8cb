"""What a recording says of bodies that gravity moves: they fall onto level ground, roll down a slope, or slide
alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.gravity import (
    FEWEST_ROWS,
    Descent,
    Fall,
    Stretches,
    deformation,
    descent,
    foot_speed,
    impact,
    rounding,
    trend,
)
from gpusimbench.evaluator.metrics.physics.solids import FixedBox, largest, length, nearest, rotations
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import Check, Fact, Facts, measured
from gpusimbench.evaluator.runs.physics.states import Setting, States
from gpusimbench.evaluator.runs.physics.world import FixedBody

_BEFORE = (Check.FALL, Check.FALL_LEAD, Check.FALL_SHAPE)
_AFTER = (Check.IMPACT_TIME, Check.IMPACT_SPEED, Check.REBOUND)
_MOST_ROWS = 1 << 14  # until the ground or the foot; a step so short that there are more is no simulator's
_AHEAD = 2  # steps by which a method of first order may reach the ground early

_CHECKS = (Check.ROLLING, Check.FOOT_SPEED, Check.SLIP)
_LEVEL = float(np.cos(np.radians(2.0)))  # of a face, to count as flat on the ground
_HOVER = 1e-3  # between the heights of a cube that slides and of one that lies [m]
_SPIN = 0.3  # speed of a corner about the centre over the speed, to count as sliding straight
_SHARE = 0.05  # of the coefficient: a spin of 30 % takes 2 %, a tilt of 2 degrees lifts it for a while
Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def fall_facts(setting: Setting) -> Facts:
    """Acceleration, its first-order error and the shape while all bodies fall; the impact and the rebound."""
    fall = _find_fall(setting)
    if isinstance(fall, Missing):
        return dict.fromkeys((*_BEFORE, *_AFTER), fall)
    dt = setting.dt
    rows = int((fall.duration - _AHEAD * dt) / setting.row_time) + 1
    if 2 * rows > _MOST_ROWS:
        return dict.fromkeys((*_BEFORE, *_AFTER), Missing(f"more than {_MOST_ROWS} rows until the ground"))
    return {**_falling(setting, fall, rows), **_landing(setting, fall)}


def _falling(setting: Setting, fall: Fall, rows: int) -> Facts:
    if rows < FEWEST_ROWS or rows > len(setting.walk):
        why = (
            f"fewer than {FEWEST_ROWS} rows were recorded in the air"
            if rows < FEWEST_ROWS
            else "the states end in the air"
        )
        return dict.fromkeys(_BEFORE, Missing(why))
    states = setting.walk.rows(0, rows)
    gravity, dt = fall.gravity, setting.dt
    fit = trend(states.step * dt, states.position[..., 2].mean(axis=2))
    highest = max(body.start[2] for body in setting.world.moving)
    drift = rounding(
        rows * setting.stride, dt, largest_place=highest, largest_speed=fall.speed, epsilon=setting.walk.epsilon
    )
    slack = fit.gain * drift
    # across the fall as well, where an origin makes coordinates large
    reach = setting.walk.offset + float(abs(states.position).max())
    carried = rounding(
        rows * setting.stride, dt, largest_place=reach, largest_speed=fall.speed, epsilon=setting.walk.epsilon
    )
    method = -fit.lead / (gravity * dt)
    shape = setting.slack(setting.fall, carried, "g dt^2, and rounding")
    return {
        Check.FALL: measured(
            -fit.acceleration, low=gravity, high=gravity, tolerance=slack, of="rounding of every step"
        ),
        Check.FALL_LEAD: measured(
            method, low=-0.5, high=0.5, tolerance=slack * fall.duration / (gravity * dt),
            of="rounding of every step", note=_method(float(method.mean())),
        ),
        Check.FALL_SHAPE: shape if isinstance(shape, Missing) else measured(
            deformation(states.position), tolerance=shape.size, of=shape.of
        ),
    }  # fmt: skip


def _landing(setting: Setting, fall: Fall) -> Facts:
    rows = int(1.5 * fall.duration / setting.row_time) + 2
    if rows > len(setting.walk):
        return dict.fromkeys(_AFTER, Missing("the states end before or soon after the impact"))
    states = setting.walk.rows(0, rows)
    if states.linear is None:
        return dict.fromkeys(_AFTER, Missing("velocities were not recorded"))
    bodies = setting.world.moving
    floor = min(body.start[2] for body in bodies)
    front = [i for i, body in enumerate(bodies) if body.start[2] - floor < body.reach]
    up = states.linear[..., 2]
    together = up @ setting.world.mass / setting.world.mass.sum()
    found = impact(states.step * setting.dt, up[..., front].mean(axis=2), together)
    slack = setting.dt + setting.row_time
    bounce = setting.world.restitution
    return {
        Check.IMPACT_TIME: measured(
            found.time, low=fall.duration, high=fall.duration, tolerance=slack,
            of="a step, and a row",
        ),
        Check.IMPACT_SPEED: measured(
            found.speed, low=fall.speed, high=fall.speed, tolerance=fall.gravity * slack,
            of="g times a step and a row",
        ),
        Check.REBOUND: measured(
            found.rebound, low=0.0, high=bounce, tolerance=fall.gravity * slack / fall.speed,
            of="g times a step and a row, over the speed", note=f"the scene says at most {bounce:g}",
        ),
    }  # fmt: skip


def _find_fall(setting: Setting) -> Fall | Missing:
    if (otherwise := setting.begun_otherwise) is not None:
        return otherwise
    bodies = setting.world.moving
    tops = [body.top for body in setting.world.fixed]
    if not tops or not all(body.level for body in setting.world.fixed) or not all(b.rests for b in bodies):
        return Missing("the scene is not bodies at rest above level ground alone")
    height = min(body.start[2] - body.radius - body.half for body in bodies) - max(tops)
    if height <= max(body.reach for body in bodies):
        return Missing("bodies start on the ground or next to it")
    return Fall(height, setting.world.gravity)


def _method(lead: float) -> str:
    """Which method a first-order error of the fall in g dt is that of."""
    if abs(lead) < 0.01:
        return "second order, or exact"
    kind = "semi-implicit" if lead > 0 else "explicit"
    parts = 0.5 / abs(lead)
    whole = round(parts)
    if whole < 1 or abs(parts - whole) > 0.02 * whole:
        return "no Euler method"
    return f"{kind} Euler" + (f", {whole} substeps" if whole > 1 else "")


def slope_facts(setting: Setting) -> Facts:
    """Acceleration, speed at the foot, and slip of the first ball that starts at rest on a slope."""
    found = _find_descent(setting)
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


def _find_descent(setting: Setting) -> tuple[int, Descent] | Missing:
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
