"""How large the buffers of a GPU must be: counted on PhysX on the CPU, whose contacts are made by the same rules."""

from __future__ import annotations

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.sapien.bodies import add_bodies
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.schemas.provenance import Buffer

_PROTOCOL_STEPS = 1100  # warm-up and timed steps
_MARGIN = 1.5  # environments at different origins go different ways
_PATCHES_OF_A_PAIR = 2  # a box that meets two faces of another has as many patches of contact points

DEFAULTS = {
    "max_rigid_contact_count": 2**19,
    "max_rigid_patch_count": 81920,
    "found_lost_pairs_capacity": 2**18,
    "collision_stack_size": 2**22,
    "temp_buffer_capacity": 2**24,
    "heap_capacity": 2**26,
}
"""SAPIEN's own."""


def choose_sizes(
    scene: Scene, *, n_env: int, dt: float, options: SapienOptions, defaults: dict[str, int]
) -> tuple[Buffer, ...]:
    """Every capacity: the one that was asked for, or what was measured and a margin, or the default if that is more.

    To be called once the process-wide settings are those of the simulation.
    """
    points, pairs, steps = measure(scene, dt=dt)
    moving, shapes = len(scene.moving()), len(scene.bodies)
    meetings = moving * (shapes - 1) - moving * (moving - 1) // 2  # pairs of shapes of which one moves
    by = f"of one env on the CPU in {steps} steps, times {_MARGIN:g} and the number of envs, or the default"
    measured = {
        "max_rigid_contact_count": (points, f"{points} contact points {by}"),
        "max_rigid_patch_count": (
            pairs * _PATCHES_OF_A_PAIR,
            f"{pairs} pairs, {_PATCHES_OF_A_PAIR} patches each, {by}",
        ),
        "found_lost_pairs_capacity": (meetings, f"all {meetings} pairs of shapes that could meet {by}"),
    }
    buffers = []
    for name, default in defaults.items():
        asked: int = getattr(options, name, 0)
        if asked:
            buffers.append(Buffer(name, asked, "all", sized_by=f"option {name}"))
        elif name in measured:
            needed, how = measured[name]
            buffers.append(Buffer(name, max(default, int(needed * _MARGIN * n_env)), "all", sized_by=how))
        else:
            buffers.append(Buffer(name, default, "all", sized_by="the engine's default"))
    return tuple(buffers)


def measure(scene: Scene, *, dt: float) -> tuple[int, int, int]:
    """The most contact points and the most touching pairs of a step in one environment, and the steps made."""
    import sapien
    from sapien import physx

    system = physx.PhysxCpuSystem()
    system.timestep = dt
    world = sapien.Scene([system])
    add_bodies(world, scene, SapienOptions())
    steps = max(_PROTOCOL_STEPS, round(scene.sample_time / dt))
    points = pairs = 0
    for _ in range(steps):
        system.step()
        contacts = system.get_contacts()
        pairs = max(pairs, len(contacts))
        points = max(points, sum(len(contact.points) for contact in contacts))
    return points, pairs, steps
