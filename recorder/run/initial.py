"""Initial states that are drawn, so that environments do not all begin alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.run import draws
from gpusimbench.recorder.run.draws import GRID
from gpusimbench.recorder.scenes.base import Body, Scene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.treatment import MOST_SPREAD, Initial

_STREAM = 0x494E4954  # tells these words from those of actions, which the same seed draws


def states(
    initial: Initial, scene: Scene, fields: tuple[StateField, ...], first: States, seed: int
) -> tuple[NDArray[np.floating], ...]:
    """The first state [env, item, width] of each field, in its precision, with what is drawn for it added.

    Added is, uniformly within +- spread and independently for each environment:

        to the linear velocity of every free body, along each axis, or along the one that the body is launched along, by
        the first of the three draws [m/s]
        to the angular velocity of the free bodies that say so, times the body's share for each axis [rad/s]
        to the angle of every joint [rad], times the joint's share where the robot has any, kept within its limits

    No body is moved, so that none penetrates another.
    """
    found, limits = [], scene.joint_limits()
    bodies = {(body.group, body.name): body for body in scene.moving()}
    for place, (layout, array) in enumerate(zip(fields, first, strict=True)):
        drawn = draw(initial, seed, place, array.shape)
        if layout.field == "qpos" and scene.robot is not None and scene.robot.drawn is not None:
            drawn *= np.array(scene.robot.drawn)[:, None]
        added = _added(layout.field, [bodies.get((layout.group, name)) for name in layout.items], drawn)
        if added is None:
            found.append(array.copy())
            continue
        given = array + added.astype(array.dtype)
        if layout.field == "qpos" and layout.group in limits:
            bounds = np.array(limits[layout.group], dtype=array.dtype)
            given = np.clip(given, bounds[:, :1], bounds[:, 1:])
        found.append(given.astype(array.dtype))
    return tuple(found)


def _added(field: str, bodies: Sequence[Body | None], drawn: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """What is added of the drawn numbers [env, item, width] to a field of these bodies; None where it stays."""
    if field == "qpos":
        return drawn
    if field == "linear_velocity":
        for item, body in enumerate(bodies):
            if body is not None and body.launch is not None:
                drawn[:, item] = drawn[:, item, :1] * np.array(body.launch)
        return drawn
    if field == "angular_velocity" and any(body is not None and body.spin for body in bodies):
        return np.asarray(drawn * np.array([(body and body.spin) or (0.0, 0.0, 0.0) for body in bodies]))
    return None


def draw(initial: Initial, seed: int, field: int, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """What is added to a field of this shape [env, item, width], the `field`-th of the layout: drawn as
    ``recorder.run.draws`` says, with the stream 0x494E4954."""
    return draws.draw(initial, initial.spread, seed=seed, stream=_STREAM, field=field, shape=shape)


def parse(text: str, n_env: int) -> str:
    """What --initial says of drawn states, as the recording keeps it. UsageError where nothing can be drawn so."""
    try:
        drawn = Initial.parse(text)
        if drawn.spread < GRID or (drawn.but or 0) >= n_env:
            raise ValueError(text)
    except ValueError:
        raise UsageError(
            f"--initial is random:SPREAD, with a spread from {GRID:.2g} to {MOST_SPREAD:g} (of velocities in m/s, of "
            "joint angles in rad), and may end with ,shift:K or with ,but:E, an environment, "
            f"not '{text}'"
        ) from None
    return str(drawn)
