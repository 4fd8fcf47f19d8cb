"""Options of PhysX as SAPIEN offers them, by the names that they have there."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from gpusimbench.recorder.options import ABOVE_0, FROM_0, NOT_NEGATIVE, one_of, require

BUFFERS = (
    "max_rigid_contact_count", "max_rigid_patch_count", "found_lost_pairs_capacity", "collision_stack_size",
    "temp_buffer_capacity", "heap_capacity",
)  # fmt: skip
"""Capacities that a simulation on a GPU is given, and one on the CPU does not have."""

GPU_ONLY = ("spacing", *BUFFERS)


@dataclass(frozen=True)
class SapienOptions:
    """Options of PhysX; those of a GPU are without effect on the CPU, and recorded as null there.

    device                      cpu or cuda (the first GPU that CUDA shows)
    solver_position_iterations  of the solver, at each step; SAPIEN's default
    solver_velocity_iterations  the same
    bounce_threshold            speed of closing above which a contact bounces [m/s]. SAPIEN's default, 2, is more than
                                the ball of inclined-collision has; gravity adds 0.1 in each step of 0.01 s
    contact_offset              distance from a shape at which contacts are made [m]; a pair of shapes that is nearer
                                than the sum has contact points. SAPIEN's default, 0.01, is half a cube of the published
                                scenes
    rest_offset                 distance from a shape at which others come to rest [m]
    sleep_threshold             kinetic energy by mass below which a body is put to sleep [m2/s2]; 0: never. SAPIEN's
                                default is 0.005
    angular_damping             of every body [1/s]; the scenes have none. PhysX's default is 0.05
    max_angular_velocity        of every body [rad/s], a limit that PhysX wants; its default is 100
    enable_tgs                  the solver TGS, or else PGS
    enable_pcm                  contact points are kept from step to step; a GPU always does
    enable_ccd                  continuous collision detection
    enable_friction_every_iteration  friction is solved at each iteration of the solver, not at the last ones alone
    cpu_workers                 further threads of each PhysxCpuSystem; 0: the one that calls it
    spacing                     distance between the origins of environments on a GPU [m]
    max_rigid_contact_count     contact points of all environments for which a GPU has room; 0: as many as were
                                measured and a margin, or the engine's default where that is more. The same for:
    max_rigid_patch_count       patches of contact points
    found_lost_pairs_capacity   pairs of shapes that come near each other, or part, in one step
    collision_stack_size        memory of collision detection [byte]; 0: the engine's default
    temp_buffer_capacity        memory of one step [byte]; 0: the engine's default
    heap_capacity               memory of what lasts longer [byte]; 0: the engine's default
    """

    device: str = "cpu"
    solver_position_iterations: int = 10
    solver_velocity_iterations: int = 1
    bounce_threshold: float = 0.2
    contact_offset: float = 0.005
    rest_offset: float = 0.0
    sleep_threshold: float = 0.0
    angular_damping: float = 0.0
    max_angular_velocity: float = 1e4
    enable_tgs: bool = True
    enable_pcm: bool = True
    enable_ccd: bool = False
    enable_friction_every_iteration: bool = True
    cpu_workers: int = 0
    spacing: float = 5.0
    max_rigid_contact_count: int = 0
    max_rigid_patch_count: int = 0
    found_lost_pairs_capacity: int = 0
    collision_stack_size: int = 0
    temp_buffer_capacity: int = 0
    heap_capacity: int = 0

    def __post_init__(self) -> None:
        self._check_device()
        if not 1 <= self.solver_position_iterations <= _MOST_ITERATIONS:
            raise ValueError(
                f"solver_position_iterations is from 1 to {_MOST_ITERATIONS}, not {self.solver_position_iterations}"
            )
        if not 0 <= self.solver_velocity_iterations <= _MOST_ITERATIONS:
            raise ValueError(
                f"solver_velocity_iterations is from 0 to {_MOST_ITERATIONS}, not {self.solver_velocity_iterations}"
            )
        require(self, ABOVE_0, "bounce_threshold", "contact_offset", "spacing", "max_angular_velocity")
        require(self, FROM_0, "sleep_threshold", "angular_damping")
        if not -math.inf < self.rest_offset < self.contact_offset:
            raise ValueError(f"rest_offset is below contact_offset, {self.contact_offset}, not {self.rest_offset}")
        require(self, NOT_NEGATIVE, "cpu_workers", *BUFFERS)

    def _check_device(self) -> None:
        one_of("device", self.device, ("cpu", "cuda"))

    def in_force(self, device: str, buffers: dict[str, int] | None) -> dict[str, object]:
        """Every option as it is used on a device ("cpu" or "cuda"), with the capacities that a GPU was given."""
        values: dict[str, object] = {field.name: getattr(self, field.name) for field in fields(self)}
        values["device"] = device
        if buffers is None:
            return {**values, **dict.fromkeys(GPU_ONLY)}
        return {**values, **buffers, "enable_pcm": True}


_MOST_ITERATIONS = 255  # PhysX keeps each of the two numbers in a byte
