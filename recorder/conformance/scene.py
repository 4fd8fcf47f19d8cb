"""One scene in which everything that is held against a formula happens at once, out of each other's reach.

A ball rolls down a slope from rest, two cubes stand on a board, a pebble falls beside them, a stone and a marble fly.
For N_STEP steps nothing else meets: the ball stays on its slope, the fliers stay above all the rest.
"""

from __future__ import annotations

import math

from gpusimbench.recorder.scenes.base import Body, Box, Quaternion, Scene, Sphere, Vector
from gpusimbench.recorder.scenes.cube_stack import EDGE, MASS, ROUGH_WOOD, SMOOTH_WOOD
from gpusimbench.recorder.scenes.inclined_collision import SLOPE_ANGLE, STEEL_304

G = 9.81
N_ENV = 3
N_STEP = 50
DT = 0.01

BALL, PEBBLE, LOWER, UPPER, STONE, MARBLE = "ball", "pebble", "lower_cube", "upper_cube", "stone", "marble"

SPIN = 2.0
"""Angular speed of the stone about its shortest edge [rad/s]."""

_THICKNESS = 0.02  # of board and slope
_RADIUS = 0.0175
_SLOPE_CENTRE = (-0.5, 0.0, 0.5)
_PEBBLE_RADIUS = 0.01
_UPHILL = 0.3  # where the ball starts, from the slope's centre; it rolls about as far in N_STEP steps

LANDING = 10
"""Steps after which the pebble touches the board."""

# tilts about no axis of the world, so that no mix-up of axes, orders or frames goes unseen
_STONE_TILT: Quaternion = (0.5, 0.1, 0.7, 0.5)
_MARBLE_TILT: Quaternion = (0.7, -0.5, 0.1, 0.5)


def conformance_scene() -> Scene:
    """The scene: six bodies that move, in three groups whose members do not follow each other."""
    table = _THICKNESS
    return Scene(
        name="conformance",
        summary="a rolling ball, a resting stack, a falling pebble and two bodies in free flight",
        gravity=(0.0, 0.0, -G),
        board="board",
        dt=DT,
        sample_time=N_STEP * DT,
        bodies=(
            Body("board", Box((0.3, 0.3, _THICKNESS)), ROUGH_WOOD, position=(1.0, 0.0, _THICKNESS / 2)),
            Body(
                "slope",
                Box((1.0, 0.2, _THICKNESS)),
                SMOOTH_WOOD,
                position=_SLOPE_CENTRE,
                orientation=(math.cos(SLOPE_ANGLE / 2), 0.0, math.sin(SLOPE_ANGLE / 2), 0.0),
            ),
            Body(BALL, Sphere(_RADIUS), STEEL_304, mass=0.17782, group="balls", position=_on_the_slope()),
            _cube(LOWER, table + EDGE / 2),
            Body(
                STONE,
                Box((0.02, 0.04, 0.06)),
                SMOOTH_WOOD,
                mass=0.1,
                group="flying",
                position=(0.0, 0.0, 2.0),
                orientation=_STONE_TILT,
                linear_velocity=(1.0, -2.0, 3.0),
                # a principal axis: without torque it keeps its direction and its speed
                angular_velocity=_scaled(_first_axis(_STONE_TILT), SPIN),
            ),
            _cube(UPPER, table + EDGE * 3 / 2),
            Body(
                PEBBLE,
                Sphere(_PEBBLE_RADIUS),
                SMOOTH_WOOD,
                mass=0.02,
                group="balls",
                position=(0.9, 0.0, table + _PEBBLE_RADIUS + G * (LANDING * DT) ** 2 / 2),
            ),
            Body(
                MARBLE,
                Sphere(0.02),
                STEEL_304,
                mass=0.1,
                group="flying",
                position=(0.0, 1.0, 2.0),
                orientation=_MARBLE_TILT,
                linear_velocity=(-1.0, 2.0, 0.5),
                angular_velocity=(1.5, -1.0, 0.5),
            ),
        ),
    )


def _cube(name: str, height: float) -> Body:
    return Body(
        name, Box((EDGE, EDGE, EDGE)), SMOOTH_WOOD, mass=MASS, group="cubes", position=(1.0, 0.0, round(height, 9))
    )


def _on_the_slope() -> Vector:
    """Where the ball's centre is while it touches the slope, uphill of the slope's centre."""
    sine, cosine = math.sin(SLOPE_ANGLE), math.cos(SLOPE_ANGLE)
    above = _THICKNESS / 2 + _RADIUS
    x, y, z = _SLOPE_CENTRE
    return (x - _UPHILL * cosine + above * sine, y, z + _UPHILL * sine + above * cosine)


def _first_axis(orientation: Quaternion) -> Vector:
    """The body's x axis in the world: the first column of the rotation matrix."""
    w, x, y, z = orientation
    return (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))


def _scaled(vector: Vector, factor: float) -> Vector:
    x, y, z = vector
    return (factor * x, factor * y, factor * z)
