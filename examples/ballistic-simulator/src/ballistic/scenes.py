"""A scene of this package's own: three dice fall onto a table and come to rest."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Box, Material, Plane, Scene

WOOD = Material("wood", static_friction=0.4, kinetic_friction=0.3, restitution=0.3)
EDGE = 0.02


def tilted_dice() -> Scene:
    """Each die begins tilted about another axis, at another height, and turns; nothing is random."""
    tilts = ((0.9, 0.3, 0.3, 0.1), (0.8, -0.2, 0.4, 0.4), (0.7, 0.5, -0.1, 0.5))  # each of length one
    dice = (
        Body(
            name=f"die_{i}",
            group="cubes",
            shape=Box((EDGE, EDGE, EDGE)),
            material=WOOD,
            mass=0.006,
            position=(0.08 * (i - 1), 0.0, 0.10 + 0.05 * i),
            orientation=tilt,
            angular_velocity=(0.0, 5.0 * i, 0.0),
        )
        for i, tilt in enumerate(tilts)
    )
    return Scene(
        name="tilted-dice",
        summary="three tilted dice fall from 10, 15 and 20 cm onto a table",
        sample_time=2.0,
        bodies=(Body("table", Plane(), WOOD, position=(0.0, 0.0, 0.0)), *dice),
    )
