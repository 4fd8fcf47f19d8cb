"""A 3x3x3 stack of cubes falls onto a ground plane (GPUSimBench, free-fall).

The paper gives neither the cubes' properties nor the drop height. Here the cubes are those of inclined-collision and
the lowest faces start 0.5 m above the ground, reached after sqrt(2 * 0.5 / 9.81) = 0.319 s.
"""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Plane, Scene
from gpusimbench.recorder.scenes.cube_stack import COUNT, EDGE, ROUGH_WOOD, cube_stack

DROP_HEIGHT = 0.5


def free_fall() -> Scene:
    """The scene with this project's drop height."""
    centre = DROP_HEIGHT + COUNT * EDGE / 2
    return Scene(
        name="free-fall",
        summary=f"a 3x3x3 stack of cubes falls {DROP_HEIGHT} m onto a ground plane",
        parameters={"drop_height_m": DROP_HEIGHT},
        bodies=(
            Body("ground", Plane(), ROUGH_WOOD, position=(0.0, 0.0, 0.0)),
            *cube_stack((0.0, 0.0, centre)),
        ),
    )
