"""A substep of Madrona's XPBD for a box that slides on a plane: what its contact lifts, and what is taken back.

Describes what src/physics/xpbd.cpp of Madrona b31034b computes, in the plane of sliding and for small angles. The
unknowns are the height and the pitch of the box; its speed along the plane enters nowhere, as long as it slides. Depths
are in units of g h^2, impulses in units of m g h (the weight in a substep), lengths in half edges along the plane:
neither the substep h, nor gravity, nor the mass is left in the equations.
"""

from __future__ import annotations

_RESTITUTION = 0.3  # written into Madrona, for closing speeds above twice g h
_SUBSTEPS = 4000
_SETTLED = 400  # substeps after which the rocking repeats itself


def normal_impulses(friction: float, height: float, *, count_both: bool = False) -> tuple[float, float]:
    """Mean normal impulse of the position solve, and of the velocity solve, in a substep [m g h].

    friction    the friction impulse of a substep, over the normal impulse that it is computed from
    height      of the box, over its edge along the plane
    count_both  friction is computed from the impulses of both solves, and not from the first alone

    The first is what Madrona's friction counts. Their sum is 1, the weight, as long as the box neither rises nor falls.
    """
    inertia = (
        1.0 + height**2
    ) / 3.0  # of a solid box about the axis across the plane, over m and the half edge squared
    depth = pitch = speed = turning = 0.0  # of the centre; of the front below it; and their rates
    positions, velocities = [], []
    for _ in range(_SUBSTEPS):
        depth_before, pitch_before = depth, pitch
        speed += 1.0
        depth += speed
        pitch += turning
        touching = [(d, x) for d, x in ((depth + pitch, 1.0), (depth - pitch, -1.0)) if d >= 0.0]  # front, back
        total = sum(d for d, _ in touching)
        lift = given_back = 0.0
        if total > 0.0:
            # one point for all: their mean weighted by depth, and the largest depth
            at = sum(d * x for d, x in touching) / total
            ease = 1.0 + at**2 / inertia  # the generalised inverse mass there, times the mass
            lift = max(d for d, _ in touching) / ease
            closing = speed + turning * at
            depth -= lift
            pitch -= lift * at / inertia
            speed, turning = depth - depth_before, pitch - pitch_before
            bounce = _RESTITUTION * max(closing, 0.0) if abs(closing) > 2.0 else 0.0
            given_back = (bounce + speed + turning * at) / ease
            speed -= given_back
            turning -= given_back * at / inertia
            counted = abs(lift + given_back) if count_both else lift
            turning += friction * counted * height / inertia
        positions.append(lift)
        velocities.append(given_back)
    n = _SUBSTEPS - _SETTLED
    return sum(positions[_SETTLED:]) / n, sum(velocities[_SETTLED:]) / n


def corner_inverse_mass(height: float) -> float:
    """Generalised inverse mass of a box with a square base at a lower corner, along its edge, times its mass.

    w = 1/m + (r x t) . I^-1 (r x t), with t along x and r = (1, 1, -height) in half edges of the base. The moments of
    inertia are m (1 + height^2) / 3 about y and 2 m / 3 about z. For a cube it is 4.
    """
    return 1.0 + 3.0 * height**2 / (1.0 + height**2) + 1.5
