"""A cube is thrown onto a table: the scene of 570 measured tosses (ContactNets, arXiv 2009.11193).

Mass, edge and friction are the published facts. Restitution is not known: engines are given 0, which those without a
coefficient cannot honour, and mechanics is judged as if it could be up to 1. The cube's moment of inertia is that of a
uniform solid, 0.000677 kg m2; the authors of the data give 0.00081 kg m2. Without measured initial states, environments
begin with a typical toss.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

from gpusimbench.recorder.scenes.base import Body, Box, Material, Plane, Scene
from gpusimbench.schemas.errors import UsageError

EDGE = 0.1048
MASS = 0.37
RATE = 148.0  # rows per second of the measurement
ROWS = 442  # of the longest published toss

MOST_FRICTION = 10.0

ACRYLIC = Material("acrylic on a table", static_friction=0.18, kinetic_friction=0.18, restitution=0.0)


class TossScene(Scene):
    """The scene, with the option `friction`: another coefficient of both surfaces than the published one."""

    own_options: ClassVar[frozenset[str]] = frozenset({"friction"})

    def with_options(self, given: Mapping[str, str]) -> Self:
        """See Scene.with_options; another friction makes another scene, with a SHA-256 of its own."""
        if "friction" not in given:
            return self
        try:
            value = float(given["friction"])
        except ValueError:
            value = -1.0
        if not 0 <= value <= MOST_FRICTION:
            raise UsageError(
                f"option 'friction' of scene '{self.name}' is a number from 0 to {MOST_FRICTION:g}, "
                f"not '{given['friction']}'"
            )
        if value == ACRYLIC.static_friction:
            return self
        surface = replace(ACRYLIC, static_friction=value, kinetic_friction=value)
        bodies = tuple(replace(body, material=surface) for body in self.bodies)
        return replace(self, bodies=bodies, parameters={**self.parameters, "friction": value})


def cube_toss() -> Scene:
    """The scene with the published facts."""
    return TossScene(
        name="cube-toss",
        summary="a cube of 0.37 kg is thrown onto a table, from measured initial states",
        dt=1.0 / RATE,
        sample_time=(ROWS - 1) / RATE,
        tosses=True,
        parameters={"restitution_known": False},
        bodies=(
            Body("table", Plane(), ACRYLIC, position=(0.0, 0.0, 0.0)),
            Body(
                "cube",
                Box((EDGE, EDGE, EDGE)),
                ACRYLIC,
                mass=MASS,
                group="cubes",
                position=(0.3, 0.0, 0.14),
                linear_velocity=(-1.0, 0.0, 0.4),
                angular_velocity=(0.0, -3.5, 0.0),
            ),
        ),
    )
