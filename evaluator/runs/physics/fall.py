"""What a recording says of bodies that fall from rest onto level ground."""

from __future__ import annotations

from gpusimbench.evaluator.metrics.physics.falling import Fall, deformation, impact
from gpusimbench.evaluator.metrics.physics.trend import FEWEST_ROWS, rounding, trend
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import Check, Facts, measured
from gpusimbench.evaluator.runs.physics.setting import Setting

_BEFORE = (Check.FALL, Check.FALL_LEAD, Check.FALL_SHAPE)
_AFTER = (Check.IMPACT_TIME, Check.IMPACT_SPEED, Check.REBOUND)
_MOST_ROWS = 1 << 14
_AHEAD = 2  # steps by which a method of first order may reach the ground early


def fall_facts(setting: Setting) -> Facts:
    """Acceleration, its first-order error and the shape while all bodies fall; the impact and the rebound."""
    fall = _find(setting)
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


def _find(setting: Setting) -> Fall | Missing:
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
