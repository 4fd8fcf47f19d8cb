"""Options of PhysX, and where they go in USD."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from gpusimbench.recorder.options import one_of
from gpusimbench.recorder.scenes.emit.usd_prim import Apis, Value

SOLVERS = ("TGS", "PGS")
COMBINE_MODES = ("average", "min", "max", "multiply")

OF_MODELS = {"friction_combine": "max"}
"""Options where a model file is simulated and the user says nothing."""

OF_THE_GPU = (
    "max_contacts", "max_patches", "max_pairs", "max_aggregate_pairs", "collision_stack", "heap", "temp_buffer",
)  # fmt: skip
"""Options without effect on the CPU."""

_ITERATIONS = 255  # at most, of either kind
_BYTES = ("collision_stack", "heap", "temp_buffer")
_UNLIMITED = 1e16  # [degrees/s], the largest angular speed that the engine can be given
_TYPES = {"gpuTempBufferCapacity": "uint64"}  # of the capacities that are no "uint"

NO_THRESHOLD = 1e-6
"""ovphysx's default of bounce_threshold [m/s], and the least that it takes."""

LARGEST = 2**32 - 1
"""That a buffer of the GPU can be: an unsigned integer of 32 bits."""


@dataclass(frozen=True)
class PhysxOptions:
    """Options of PhysX.

    device                         auto (the first GPU that CUDA shows, else the CPU), cpu or cuda
    spacing                        of neighbouring environments in one scene [m]; 0: all at the same place, told apart
                                   by ids, which a GPU alone can do
    solver                         TGS or PGS
    position_iterations            of the solver, from 1 on
    velocity_iterations            of the solver
    external_forces_every_iteration  of TGS: gravity acts in every position iteration, as ovphysx has it; false: once a
                                   step, as before ovphysx 0.7
    bounce_threshold               closing speed below which nothing rebounds [m/s]; ovphysx's default is none
    contact_offset                 of each shape [m]: a pair nearer than both has contacts
    rest_offset                    of each shape [m]: distance at which a pair rests; less than contact_offset
    friction_combine               of a pair of materials: average, min, max or multiply
    restitution_combine            the same
    friction_offset_threshold      distance from which a contact has friction [m]
    friction_correlation_distance  within which contacts share a point of friction [m]
    max_depenetration_velocity     by which shapes that overlap are pushed apart [m/s]
    max_angular_velocity           of a body [rad/s]; 0: no limit
    threads                        CPU threads of the engine; 0: as many as the process may use
    max_contacts                   GPU: contact points per environment for which there is room; 0: measured
    max_patches                    GPU: patches of contact per environment; 0: measured
    max_pairs                      GPU: pairs of bounding boxes per environment that begin or end to overlap in one
                                   step; 0: measured
    max_aggregate_pairs            GPU: the same between robots and what they meet, and within; 0: measured
    collision_stack                GPU: bytes of scratch memory of collision detection; 0: by the number of pairs
    heap                           GPU: bytes at first; grows as needed
    temp_buffer                    GPU: bytes at first; grows as needed
    """

    device: str = "auto"
    spacing: float = 4.0
    solver: str = "TGS"
    position_iterations: int = 16
    velocity_iterations: int = 1
    external_forces_every_iteration: bool = True
    bounce_threshold: float = NO_THRESHOLD
    contact_offset: float = 0.005
    rest_offset: float = 0.0
    friction_combine: str = "average"
    restitution_combine: str = "average"
    friction_offset_threshold: float = 0.04
    friction_correlation_distance: float = 0.025
    max_depenetration_velocity: float = 3.0
    max_angular_velocity: float = 0.0
    threads: int = 0
    max_contacts: int = 0
    max_patches: int = 0
    max_pairs: int = 0
    max_aggregate_pairs: int = 0
    collision_stack: int = 0
    heap: int = 64 << 20
    temp_buffer: int = 16 << 20

    def __post_init__(self) -> None:
        one_of("solver", self.solver, SOLVERS)
        for name in ("friction_combine", "restitution_combine"):
            one_of(name, getattr(self, name), COMBINE_MODES)
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{field.name} is a finite number, not {value}")
            if not isinstance(value, str) and field.name != "rest_offset" and value < 0:
                raise ValueError(f"{field.name} is a number from 0 on, not {value}")
        if self.bounce_threshold < NO_THRESHOLD:
            raise ValueError(f"bounce_threshold is at least {NO_THRESHOLD} m/s, not {self.bounce_threshold}")
        if not 1 <= self.position_iterations <= _ITERATIONS or self.velocity_iterations > _ITERATIONS:
            raise ValueError(
                f"position_iterations is from 1 to {_ITERATIONS} and velocity_iterations from 0 on, "
                f"not {self.position_iterations} and {self.velocity_iterations}"
            )
        if self.rest_offset >= self.contact_offset:
            raise ValueError(
                f"rest_offset is less than contact_offset, not {self.rest_offset} beside {self.contact_offset}"
            )
        for name in _BYTES:
            if getattr(self, name) > LARGEST:
                raise ValueError(f"{name} is at most {LARGEST} bytes, not {getattr(self, name)}")


def apis(options: PhysxOptions, *, gpu: bool, enhanced: bool, capacities: dict[str, int]) -> Apis:
    """The options as attributes of PhysX's schemas.

    gpu         whether dynamics and broad phase run on a GPU
    enhanced    whether determinism is enhanced
    capacities  names and sizes of the GPU's buffers
    """
    scene: dict[str, Value] = {
        "bool physxScene:enableGPUDynamics": gpu,
        "uniform token physxScene:broadphaseType": broad_phase(gpu),
        "uniform token physxScene:solverType": options.solver,
        "float physxScene:bounceThreshold": options.bounce_threshold,
        "float physxScene:frictionOffsetThreshold": options.friction_offset_threshold,
        "float physxScene:frictionCorrelationDistance": options.friction_correlation_distance,
        "bool physxScene:enableEnhancedDeterminism": enhanced,
        "bool physxScene:enableCCD": False,
        "bool physxScene:enableStabilization": False,
        "bool physxScene:disableSleeping": True,
        "bool physxScene:enableSceneQuerySupport": False,
        "uint physxScene:minPositionIterationCount": 1,
        **{f"{_TYPES.get(name, 'uint')} physxScene:{name}": size for name, size in capacities.items()},
    }
    if not options.external_forces_every_iteration:
        scene["bool physxScene:enableExternalForcesEveryIteration"] = False
    iterations = {
        "PositionIterationCount": options.position_iterations,
        "VelocityIterationCount": options.velocity_iterations,
    }
    angular = math.degrees(options.max_angular_velocity) if options.max_angular_velocity else _UNLIMITED
    return {
        "PhysxSceneAPI": scene,
        "PhysxMaterialAPI": {
            "uniform token physxMaterial:frictionCombineMode": options.friction_combine,
            "uniform token physxMaterial:restitutionCombineMode": options.restitution_combine,
        },
        "PhysxCollisionAPI": {
            "float physxCollision:contactOffset": options.contact_offset,
            "float physxCollision:restOffset": options.rest_offset,
        },
        "PhysxRigidBodyAPI": {
            **{f"int physxRigidBody:solver{name}": count for name, count in iterations.items()},
            "float physxRigidBody:linearDamping": 0.0,
            "float physxRigidBody:angularDamping": 0.0,
            "float physxRigidBody:sleepThreshold": 0.0,
            "float physxRigidBody:stabilizationThreshold": 0.0,
            "float physxRigidBody:maxDepenetrationVelocity": options.max_depenetration_velocity,
            "float physxRigidBody:maxAngularVelocity": angular,
        },
        "PhysxArticulationAPI": {
            **{f"int physxArticulation:solver{name}": count for name, count in iterations.items()},
            "float physxArticulation:sleepThreshold": 0.0,
            "float physxArticulation:stabilizationThreshold": 0.0,
            "bool physxArticulation:enabledSelfCollisions": True,
        },
    }


def broad_phase(gpu: bool) -> str:
    """The broad phase, as PhysX names it; ids of environments exist in the GPU's alone."""
    return "GPU" if gpu else "SAP"
