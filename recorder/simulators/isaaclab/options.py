"""Options of Isaac Lab: which physics it steps, and what is worth setting of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gpusimbench.recorder.options import AT_LEAST_1, FROM_0, NOT_NEGATIVE, one_of, require
from gpusimbench.recorder.simulators.mujoco.options import CONES

BACKENDS = ("ovphysx", "newton", "physx")
COMBINATIONS = ("average", "min", "multiply", "max")


@dataclass(frozen=True)
class IsaacLabOptions:
    """Options of Isaac Lab; one that a backend does not have is without effect, and recorded as null.

    backend              ovphysx: PhysX without Isaac Sim; newton: MuJoCo Warp through Newton; physx: PhysX within
                         Isaac Sim, which has to be installed
    device               auto, cpu or cuda (the first GPU that CUDA shows)
    spacing              between the origins of neighbouring environments, which lie on a grid about the world's [m];
                         0: all at the same place
    contact_offset       of each shape: two are looked at once they are nearer than the sum of theirs [m]
    rest_offset          of each shape: at rest two are apart by the sum of theirs [m]
    position_iterations, velocity_iterations  PhysX: of its solver, for each body
    bounce_threshold     PhysX: closing speed below which nothing rebounds [m/s]
    external_forces_every_iteration  PhysX: gravity is applied at each position iteration instead of once a step
    friction_combine, restitution_combine  PhysX: the coefficient of a pair of materials: average, min, multiply or max
    gpu_...              PhysX on a GPU: sizes of its buffers; 0: Isaac Lab's own, or more where what was measured for
                         this many environments needs more
    iterations, ls_iterations  newton: of the solver, and of its line search; with a model file, the file's where not
                         given
    cone                 newton: elliptic or pyramidal friction cones; with a model file, the file's where not given
    max_contacts         newton: contacts per environment for which there is room; 0: as many as were measured, and a
                         margin
    max_rows             newton: the same for rows of constraints
    """

    backend: str = "ovphysx"
    device: str = "auto"
    spacing: float = 4.0
    contact_offset: float = 0.005
    rest_offset: float = 0.0
    position_iterations: int = 16
    velocity_iterations: int = 1
    bounce_threshold: float = 0.2
    external_forces_every_iteration: bool = True
    friction_combine: str = "average"
    restitution_combine: str = "average"
    gpu_max_rigid_contact_count: int = 0
    gpu_max_rigid_patch_count: int = 0
    gpu_found_lost_pairs_capacity: int = 0
    gpu_found_lost_aggregate_pairs_capacity: int = 0
    gpu_total_aggregate_pairs_capacity: int = 0
    gpu_collision_stack_size: int = 0
    iterations: int = 100
    ls_iterations: int = 50
    cone: str = "elliptic"
    max_contacts: int = 0
    max_rows: int = 0

    def __post_init__(self) -> None:
        one_of("backend", self.backend, BACKENDS)
        one_of("cone", self.cone, CONES)
        one_of("friction_combine", self.friction_combine, COMBINATIONS)
        one_of("restitution_combine", self.restitution_combine, COMBINATIONS)
        require(self, FROM_0, "spacing", "rest_offset", "bounce_threshold")
        if not self.rest_offset < self.contact_offset < math.inf:
            raise ValueError(
                f"contact_offset is larger than rest_offset, which is {self.rest_offset}, not {self.contact_offset}"
            )
        for name, least in (("position_iterations", 1), ("velocity_iterations", 0)):
            if not least <= getattr(self, name) <= 255:
                raise ValueError(f"{name} is a number from {least} to 255, not {getattr(self, name)}")
        require(self, AT_LEAST_1, "iterations", "ls_iterations")
        require(self, NOT_NEGATIVE, *GPU_SIZES, "max_contacts", "max_rows")


GPU_SIZES = tuple(name for name in IsaacLabOptions.__dataclass_fields__ if name.startswith("gpu_"))
"""Options that are sizes of PhysX's buffers, named as in Isaac Lab's configuration."""
