"""A steel ball rolls down a wooden slope and hits a 3x3x3 stack of cubes (GPUSimBench, inclined-collision).

Matched to a real apparatus; the outcome is where the cubes lie after 5 s. Nothing is random: whatever varies between
environments or runs is numerical.
"""

from __future__ import annotations

import math

from gpusimbench.recorder.scenes.base import Body, Box, Material, Scene, Sphere
from gpusimbench.recorder.scenes.cube_stack import ROUGH_WOOD, SMOOTH_WOOD, cube_stack

STEEL_304 = Material("304 steel", static_friction=0.35, kinetic_friction=0.25, restitution=0.55)

SLOPE_ANGLE = math.radians(20.0)


def inclined_collision() -> Scene:
    """The scene with the published parameters."""
    half = SLOPE_ANGLE / 2.0  # about +y, so that the slope descends toward +x
    return Scene(
        name="inclined-collision",
        summary="a steel ball rolls down a 20 degree slope into a 3x3x3 stack of wooden cubes",
        board="board",
        parameters={"slope_angle_deg": 20.0, "temperature_C": 15.0, "humidity_percent": 15.0},
        bodies=(
            Body("board", Box((0.6, 0.6, 0.02)), ROUGH_WOOD, position=(0.3, 0.0, 0.01)),
            Body(
                "slope",
                Box((0.6, 0.1, 0.02)),
                SMOOTH_WOOD,
                position=(-0.28191, 0.0, 0.12261),
                orientation=(math.cos(half), 0.0, math.sin(half), 0.0),
            ),
            Body(
                "ball",
                Sphere(0.0175),
                STEEL_304,
                mass=0.17782,
                group="ball",
                position=(-0.22552, 0.0, 0.13135),
            ),
            *cube_stack((0.08, 0.0, 0.05)),
        ),
    )
