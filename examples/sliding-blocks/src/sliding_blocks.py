"""sliding-blocks: does kinetic friction depend on the mass?

Cubes of one size and of seven masses slide side by side on a plane. Coulomb's friction brakes all of them alike, by the
coefficient times gravity. What an engine does is the slope of the recorded velocity: `deceleration`. sliding-slabs has
flat boxes of the same masses, which Coulomb's friction brakes no less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Body, Box, Material, Plane, Scene

MASSES = (0.005, 0.05, 0.2, 1.0, 2.0, 4.0, 8.0)
"""Of the cubes [kg]: from the published scenes' wooden cubes to a heavy robot's link."""

EDGE = 0.1
"""Of every cube, and of every slab along the plane [m]."""

THICKNESS = 0.02
"""Of every slab [m]."""

FRICTION = 0.25
"""Of every pair, static and kinetic: that of the published scenes' smooth wood while it slides."""

SPEED = 5.0
"""With which all begin [m/s]."""

GRAVITY = 9.81
"""[m/s2]"""

DT = 0.01
SAMPLE_TIME = 0.5  # [s]: none has stopped then, unless it slows down by more than 10 m/s2

_FROM, _TO = 0.1, 0.4  # [s]: after the first contacts, before anything stops


def sliding_blocks() -> Scene:
    """The cubes: one group `blocks`, in the order of MASSES."""
    return _sliding("sliding-blocks", "cubes", EDGE)


def sliding_slabs() -> Scene:
    """The slabs: the same group."""
    return _sliding("sliding-slabs", "slabs", THICKNESS)


def _sliding(name: str, kind: str, height: float) -> Scene:
    wood = Material("smooth wood", static_friction=FRICTION, kinetic_friction=FRICTION, restitution=0.0)
    ground = Body("ground", Plane(), wood, position=(0.0, 0.0, 0.0))
    blocks = (
        Body(
            f"{mass:g} kg",
            Box((EDGE, EDGE, height)),
            wood,
            mass=mass,
            group="blocks",
            position=(0.0, 0.4 * lane, height / 2),
            linear_velocity=(SPEED, 0.0, 0.0),
        )
        for lane, mass in enumerate(MASSES)
    )
    return Scene(
        name=name,
        summary=f"{kind} of seven masses slide on a plane, on which Coulomb's friction brakes them alike",
        gravity=(0.0, 0.0, -GRAVITY),
        dt=DT,
        sample_time=SAMPLE_TIME,
        bodies=(ground, *blocks),
    )


def deceleration(velocity: NDArray[np.floating], dt: float) -> NDArray[np.float64]:
    """How fast each block slows down along x, a line through its speeds from 0.1 s to 0.4 s [m/s2].

    velocity  [step, env, block, 3] [m/s], with the initial state in row 0; the result is [env, block]
    """
    rows = slice(round(_FROM / dt), round(_TO / dt) + 1)
    time = dt * np.arange(len(velocity))[rows]
    speed = velocity[rows, ..., 0].astype(np.float64)
    centred = time - time.mean()
    slope: NDArray[np.float64] = np.tensordot(centred, speed, axes=(0, 0)) / (centred @ centred)
    return -slope
