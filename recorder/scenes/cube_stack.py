"""The cube that both published scenes stack, and the stack itself."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Body, Box, Material, Vector

SMOOTH_WOOD = Material("smooth wood", static_friction=0.35, kinetic_friction=0.25, restitution=0.40)
ROUGH_WOOD = Material("rough wood", static_friction=0.65, kinetic_friction=0.45, restitution=0.40)

EDGE = 0.02
MASS = 0.005
COUNT = 3


def cube_stack(centre: Vector) -> tuple[Body, ...]:
    """COUNT^3 cubes that touch their neighbours, indexed (i, j, k) along x, y, z in that nesting order.

    centre  of the stack [m]
    """

    def coordinate(axis: int, index: int) -> float:
        # rounded to a nanometre, so that the description is the decimal number that a person would write
        return round(centre[axis] + (index - (COUNT - 1) / 2) * EDGE, 9)

    return tuple(
        Body(
            name=f"cube_{i}_{j}_{k}",
            group="cubes",
            shape=Box((EDGE, EDGE, EDGE)),
            material=SMOOTH_WOOD,
            mass=MASS,
            position=(coordinate(0, i), coordinate(1, j), coordinate(2, k)),
        )
        for i in range(COUNT)
        for j in range(COUNT)
        for k in range(COUNT)
    )
