"""Options of Genesis: of its rigid solver, and of how it is started."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gpusimbench.recorder.options import ABOVE_0, AT_LEAST_1, NOT_NEGATIVE, one_of, require
from gpusimbench.recorder.simulators.mujoco.options import CONES

DEVICES = ("auto", "cpu", "cuda")
SOLVERS = ("Newton", "CG")
INTEGRATORS = ("approximate_implicitfast", "implicitfast", "Euler")
RESOLUTIONS = ("auto", "convex", "signorini")
BROADPHASES = ("auto", "SAP", "ALL_VS_ALL")


@dataclass(frozen=True)
class GenesisOptions:
    """Options of Genesis; defaults are Genesis' own, but for the sizes of its buffers.

    device                   auto (the first GPU that CUDA shows, else the CPU), cpu or cuda
    performance_mode         compile kernels for this scene alone, with arrays of fixed shape
    precision                32 or 64 bits
    substeps                 solver steps per step, each with its own collision detection
    integrator               approximate_implicitfast, implicitfast or Euler
    solver                   Newton or CG
    iterations               of the solver, at most
    ls_iterations            of its line search, at most
    tolerance                of the solver; 0: the engine's default for the precision
    noslip_iterations        of a pass after the solver that takes slip away; 0: none
    cone                     elliptic or pyramidal friction cones
    impratio                 of friction to normal impedance; 0: the engine's default for the cone
    contact_resolution       convex, signorini, or auto, the engine's default for cone and solver
    constraint_timeconst     time constant of contacts and joint limits [s]; the engine's least is two substeps
    use_gjk_collision        GJK instead of MPR between convex shapes
    box_box_detection        a collision function of its own for pairs of boxes
    mujoco_compatibility     the engine's mode that follows MuJoCo where it otherwise goes its own way
    broadphase               SAP, ALL_VS_ALL, or auto, the engine's default for the device
    max_collision_pairs      colliding pairs of shapes per environment for which there is room; 0: measured
    max_contacts             contact points per environment that the solver has room for; 0: measured
    broad_phase_multiplier   pairs that the broad phase may let through, in multiples of max_collision_pairs
    """

    device: str = "auto"
    performance_mode: bool = False
    precision: int = 32
    substeps: int = 1
    integrator: str = "approximate_implicitfast"
    solver: str = "Newton"
    iterations: int = 25
    ls_iterations: int = 50
    tolerance: float = 0.0
    noslip_iterations: int = 0
    cone: str = "pyramidal"
    impratio: float = 0.0
    contact_resolution: str = "auto"
    constraint_timeconst: float = 0.01
    use_gjk_collision: bool = False
    box_box_detection: bool = False
    mujoco_compatibility: bool = False
    broadphase: str = "auto"
    max_collision_pairs: int = 0
    max_contacts: int = 0
    broad_phase_multiplier: int = 8

    def __post_init__(self) -> None:
        one_of("device", self.device, DEVICES)
        one_of("precision", self.precision, (32, 64))
        one_of("integrator", self.integrator, INTEGRATORS)
        one_of("solver", self.solver, SOLVERS)
        one_of("cone", self.cone, CONES)
        one_of("contact_resolution", self.contact_resolution, RESOLUTIONS)
        one_of("broadphase", self.broadphase, BROADPHASES)
        require(self, AT_LEAST_1, "substeps", "iterations", "ls_iterations", "broad_phase_multiplier")
        require(self, NOT_NEGATIVE, "noslip_iterations", "max_collision_pairs", "max_contacts")
        require(
            self,
            (lambda v: 0 <= v < math.inf, "0 (the engine's default) or a positive number"),
            "tolerance",
            "impratio",
        )
        require(self, ABOVE_0, "constraint_timeconst")
