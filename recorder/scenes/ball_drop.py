"""Balls fall on a plane from several heights and bounce: when they touch it, and how fast they leave it.

    low, middle, high   0.2, 0.5 and 1 m above the plane, at rest

All surfaces are alike, so that no rule of combining them matters. With `--initial random:SPREAD` every environment
throws its balls up or down at speeds of their own.
"""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Material, Plane, Scene, Sphere

RADIUS = 0.05
MASS = 0.5
RESTITUTION = 0.6
HEIGHTS = {"low": 0.2, "middle": 0.5, "high": 1.0}
"""Of the lowest point above the plane [m]."""


def ball_drop() -> Scene:
    """The scene with its three balls, a metre apart."""
    rubber = Material("rubber", static_friction=0.5, kinetic_friction=0.5, restitution=RESTITUTION)
    return Scene(
        name="ball-drop",
        summary="balls fall on a plane from several heights and bounce",
        bodies=(
            *(
                Body(
                    name,
                    Sphere(RADIUS),
                    rubber,
                    position=(float(lane), 0.0, height + RADIUS),
                    mass=MASS,
                    group="balls",
                    launch=(0.0, 0.0, 1.0),
                )
                for lane, (name, height) in enumerate(HEIGHTS.items())
            ),
            Body("ground", Plane(), rubber, position=(0.0, 0.0, 0.0)),
        ),
        sample_time=1.5,
    )
