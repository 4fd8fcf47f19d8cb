"""Blocks slide on planks of several slopes, by Coulomb's law: how fast and how far, and whether they stick.

    level, downhill, uphill  are launched at 2 m/s on 0, 8 and -8 degrees, brake and stop
    stick                    is at rest on 12 degrees, below the angle of friction of 16.7 degrees
    slip                     is released on 25 degrees, above it

Both coefficients are equal and both surfaces are alike, so that no rule of combining them matters. With `--initial
random:SPREAD` every environment launches its blocks at its own speeds, along the planks.
"""

from __future__ import annotations

import math

from gpusimbench.recorder.scenes.base import Body, Box, Material, Quaternion, Scene, Vector

EDGE = 0.1
MASS = 1.0
SPEED = 2.0
FRICTION = 0.3
_PLANK = (8.0, 0.4, 0.02)
_HEIGHT = 2.0  # of the middle of each plank, above all of its lower end
_BEFORE = 3.2  # from the middle, along the plank, where blocks start

WOOD = Material("dry wood", static_friction=FRICTION, kinetic_friction=FRICTION, restitution=0.0)

LANES = {"level": (0.0, SPEED), "downhill": (8.0, SPEED), "uphill": (-8.0, SPEED), "stick": (12.0, 0.0),
         "slip": (25.0, 0.0)}  # fmt: skip
"""Slope [degrees], descending toward +x, and speed along it [m/s]."""


def sliding_block() -> Scene:
    """The scene with its five lanes, a metre apart."""
    bodies = [body for lane, name in enumerate(LANES) for body in _lane(name, float(lane), *LANES[name])]
    return Scene(
        name="sliding-block",
        summary="blocks slide on planks of several slopes, by Coulomb's law of friction",
        bodies=tuple(sorted(bodies, key=lambda body: not body.fixed)),
        sample_time=2.0,
    )


def _lane(name: str, y: float, degrees: float, speed: float) -> tuple[Body, Body]:
    angle = math.radians(degrees)
    turn: Quaternion = (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0)
    along: Vector = (math.cos(angle), 0.0, -math.sin(angle))
    above = _PLANK[2] / 2 + EDGE / 2
    start = (-_BEFORE * along[0] + above * math.sin(angle), y, _HEIGHT - _BEFORE * along[2] + above * math.cos(angle))
    return (
        Body(f"plank-{name}", Box(_PLANK), WOOD, position=(0.0, y, _HEIGHT), orientation=turn),
        Body(
            name,
            Box((EDGE, EDGE, EDGE)),
            WOOD,
            position=start,
            mass=MASS,
            group="cubes",
            orientation=turn,
            linear_velocity=(speed * along[0], 0.0, speed * along[2]),
            launch=along if speed else (0.0, 0.0, 0.0),
        ),
    )
