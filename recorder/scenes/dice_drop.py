"""Twelve dice fall on a plane: by symmetry, each face comes to lie on top equally often.

With `--initial random:SPREAD` every die of every environment begins with an orientation of its own, uniform over all
rotations, a velocity and a spin. Without, all dice begin alike, and their faces say nothing.
"""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Box, Material, Plane, Scene

EDGE = 0.04
MASS = 0.05
HEIGHT = 0.3
COLUMNS, ROWS = 4, 3
_APART = 0.3
_SPIN = 10.0  # share of the spread


def dice_drop() -> Scene:
    """The scene with its dice in a grid above the plane."""
    acrylic = Material("acrylic", static_friction=0.4, kinetic_friction=0.4, restitution=0.3)
    dice = (
        Body(
            f"die_{column + COLUMNS * row}",
            Box((EDGE, EDGE, EDGE)),
            acrylic,
            position=(column * _APART, row * _APART, HEIGHT),
            mass=MASS,
            group="cubes",
            spin=(_SPIN, _SPIN, _SPIN),
            turned=True,
        )
        for row in range(ROWS)
        for column in range(COLUMNS)
    )
    return Scene(
        name="dice-drop",
        summary="dice fall on a plane, and each face comes to lie on top equally often",
        bodies=(*dice, Body("ground", Plane(), acrylic, position=(0.0, 0.0, 0.0))),
        sample_time=3.0,
    )
