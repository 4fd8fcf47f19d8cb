"""Boxes of three unequal edges turn freely, without gravity: momentum and energy are kept, and the motion is periodic.

    middle    turns about its middle axis, and flips (Dzhanibekov's effect, the theorem of the tennis racket)
    long      turns about its longest edge, with the smallest moment of inertia
    short     turns about its shortest edge, with the largest moment of inertia

Nothing touches anything: an error is that of the integrator and of its gyroscopic terms. With `--initial
random:SPREAD` every environment has disturbances of its own.
"""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Box, Material, Quaternion, Scene, Vector

SIZE = (0.3, 0.2, 0.1)  # moments of inertia as 5 to 10 to 13: the middle axis is far from both others
MASS = 1.0
SPEED = 5.0
DISTURBANCE = 0.2
_SPIN = 0.3  # share of the spread
_APART = 1.0

# x of the box is y of the world, y is z, z is x, so that no mix-up of frames goes unseen
_TILT: Quaternion = (0.5, 0.5, 0.5, 0.5)
_AXES: dict[str, Vector] = {
    "middle": (DISTURBANCE, SPEED, DISTURBANCE),
    "long": (SPEED, DISTURBANCE, DISTURBANCE),
    "short": (DISTURBANCE, DISTURBANCE, SPEED),
}
"""Angular velocity in the box's own axes [rad/s]."""


def free_body() -> Scene:
    """The scene with its three boxes, a metre apart."""
    steel = Material("steel", static_friction=0.3, kinetic_friction=0.3, restitution=0.0)
    return Scene(
        name="free-body",
        summary="boxes of three unequal edges turn freely, and the one that turns about its middle axis flips",
        bodies=tuple(
            Body(
                name,
                Box(SIZE),
                steel,
                position=(0.0, lane * _APART, 1.0),
                mass=MASS,
                group="boxes",
                orientation=_TILT,
                angular_velocity=(z, x, y),
                launch=(0.0, 0.0, 0.0),
                spin=(_SPIN, _SPIN, _SPIN),
            )
            for lane, (name, (x, y, z)) in enumerate(_AXES.items())
        ),
        gravity=(0.0, 0.0, 0.0),
        sample_time=20.0,
    )
