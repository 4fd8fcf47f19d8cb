"""A cube is thrown onto a table: the scene of 570 measured tosses (ContactNets, arXiv 2009.11193).

Mass, edge and friction are the published facts. Restitution is not known: engines are given 0, which those without a
coefficient cannot honour, and mechanics is judged as if it could be up to 1. The cube's moment of inertia is that of a
uniform solid, 0.000677 kg m2; the authors of the data give 0.00081 kg m2. Without measured initial states, environments
begin with a typical toss.
"""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Box, Material, Plane, Scene

EDGE = 0.1048
MASS = 0.37
RATE = 148.0  # rows per second of the measurement
ROWS = 442  # of the longest published toss

ACRYLIC = Material("acrylic on a table", static_friction=0.18, kinetic_friction=0.18, restitution=0.0)


def cube_toss() -> Scene:
    """The scene with the published facts."""
    return Scene(
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
