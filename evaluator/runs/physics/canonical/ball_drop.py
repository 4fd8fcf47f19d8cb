"""The laws of the scene ball-drop: when a ball touches the plane, its restitution, and the energy of its bounce."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.closed_form import falling_time
from gpusimbench.evaluator.metrics.physics.gravity import bounce
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.runs.physics.canonical.motion import shaped, unevenness
from gpusimbench.evaluator.runs.physics.facts import LawValues
from gpusimbench.evaluator.runs.physics.world import Moving
from gpusimbench.schemas import checks
from gpusimbench.schemas.text import ordinal

Array = npt.NDArray[np.float64]

_NO_BOUNCE = "the ball's first bounce was not recorded from flight to flight"


def ball_laws(recording: Recording) -> tuple[LawValues, ...] | Missing:
    """The laws, or why none can be measured."""
    read = shaped(recording)
    if isinstance(read, Missing):
        return read
    world, states, time = read
    if states.linear is None:
        return Missing("velocities of the balls were not recorded")
    if recording.configuration.stride > 1:
        every = ordinal(recording.configuration.stride)
        return Missing(f"only every {every} state was recorded, and a contact is shorter")
    if len(world.floors) != 1 or not all(ball.radius for ball in world.moving):
        return Missing("the scene has other bodies than balls and a level plane")
    found: list[LawValues] = []
    for index, ball in enumerate(world.moving):
        height = states.position[:, :, index, 2] - world.floors[0].top - ball.radius
        given = _restitution(recording, index, ball)
        dt = recording.configuration.dt
        found += _ball(ball, given, time, height, states.linear[:, :, index, 2], gravity=world.gravity, dt=dt)
    return tuple(found)


def _ball(
    ball: Moving,
    given: float | Missing,
    time: Array,
    height: Array,
    speed: Array,
    *,
    gravity: float,
    dt: float,
) -> list[LawValues]:
    """The laws of a ball: heights of its lowest point above the plane, and speeds upward [row, env]."""
    bounces = [bounce(time, height[:, env], speed[:, env], gravity) for env in range(height.shape[1])]
    expected = falling_time(height[0], speed[0], gravity)
    # of sqrt(v^2 + 2 g h) / g + v / g, for a share of 1 of g
    steeper = height[0] / np.sqrt(speed[0] ** 2 + 2.0 * gravity * height[0]) - expected
    impact = float(np.sqrt(speed[0] ** 2 + 2.0 * gravity * height[0]).min())
    rebound = tuple(one.after / one.before if one.before > 0.0 else math.nan for one in bounces)
    told: tuple[float, ...] | Missing = given if isinstance(given, Missing) else (given,) * len(rebound)
    slopes = [("mass", 0.0)] + ([] if isinstance(given, Missing) else [("restitution", given)])
    drop = f"from {float(ball.start[2]) - ball.radius:g} m"
    return [
        LawValues(
            f"{ball.name}_contact", f"first contact of the ball {drop}", "s",
            tuple(one.time for one in bounces), tuple(map(float, expected)), dt, "dt",
            (("mass", 0.0), ("gravity", float(steeper.mean()))), _NO_BOUNCE, (("gravity", unevenness(steeper)),),
        ),
        LawValues(
            f"{ball.name}_restitution", f"restitution of the ball {drop}", "",
            rebound, told, gravity * dt / impact, "g dt / v", tuple(slopes), _NO_BOUNCE,
        ),
        LawValues(
            f"{ball.name}_gain", f"energy gained in the bounce of the ball {drop}, over it", "",
            tuple(max(0.0, value**2 - 1.0) if math.isfinite(value) else math.nan for value in rebound),
            (0.0,) * len(rebound), 2.0 * gravity * dt / impact, "2 g dt / v", (("mass", 0.0),), _NO_BOUNCE,
        ),
    ]  # fmt: skip


def _restitution(recording: Recording, index: int, ball: Moving) -> float | Missing:
    """The coefficient that the engine was given; Missing where it says that it has none."""
    simulation = recording.simulation
    bodies = [body for body in checks.objects(recording.scene, "bodies") if body.get("mass") is not None]
    material = checks.text(checks.mapping(bodies[index], "material"), "name", "")
    for deviation in simulation.deviations if simulation else ():
        if deviation.parameter in (f"{material}.restitution", "restitution") and deviation.used != deviation.wanted:
            return Missing("the engine has no coefficient of restitution in force")
    return ball.surface.restitution
