"""What a recording says of a ball that rolls down a slope."""

from __future__ import annotations

import numpy as np

from gpusimbench.evaluator.metrics.physics.rolling import Descent, descent, foot_speed
from gpusimbench.evaluator.metrics.physics.solids import FixedBox
from gpusimbench.evaluator.metrics.physics.trend import FEWEST_ROWS, rounding, trend
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import Check, Facts, measured
from gpusimbench.evaluator.runs.physics.setting import Setting

_CHECKS = (Check.ROLLING, Check.FOOT_SPEED, Check.SLIP)
_MOST_ROWS = 1 << 14  # until the foot; a step so short that there are more is no simulator's


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
            way.slip(linear[window], angular[window]).max(axis=0), low=None, high=0.0,
            tolerance=way.steepest * setting.dt, of="g sin(angle) dt",
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
