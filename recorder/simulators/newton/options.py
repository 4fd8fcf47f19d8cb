"""Options of Newton: which of its solvers, and what is worth setting of it."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.recorder.options import AT_LEAST_1, FROM_0, NOT_NEGATIVE, one_of, require
from gpusimbench.recorder.simulators.mujoco.options import CONES

MUJOCO_SOLVERS = ("Newton", "CG")

JOINT_SPACE = ("mujoco", "featherstone", "steel")
"""Solvers whose states have coordinates of joints; those of the others are measured from poses."""

FOR_MODELS = ("mujoco", "xpbd", "featherstone", "steel")
"""Solvers that take model files; of the others, semi-implicit was tried, and a slide with a hinge on it came to NaN."""

SOLVERS = ("mujoco", "xpbd", "steel", "semi-implicit", "featherstone", "vbd", "kamino")


@dataclass(frozen=True)
class NewtonOptions:
    """Options of Newton; one that a solver does not have is without effect, and recorded as null.

    solver               mujoco, xpbd, steel, semi-implicit, featherstone, vbd or kamino; Newton or CG: mujoco, with
                         this solver of constraints, as the simulators of MuJoCo's family call it
    substeps             solver steps per step, each with its own collision detection
    iterations           of the solver; 0: its own default
    device               auto, cpu or cuda (the first GPU that CUDA shows)
    gap                  each shape's detection distance in Newton's own collision detection [m]; a pair of shapes that
                         is nearer than both gaps has contact points. Newton's default, 0.1 m, is five cubes of the
                         published scenes and makes contacts of all pairs
    ke, kd, kf           contact stiffness [N/m], damping [N s/m] and friction gain [N s/m] of the solvers by penalty;
                         MuJoCo's solver makes its solref of ke and kd
    restitution          xpbd, steel: rebounds by the coefficients of restitution: on, off, or default, as the solver
                         ships (xpbd off, steel on)
    use_mujoco_contacts  mujoco: MuJoCo's collision detection instead of Newton's
    cone                 mujoco: elliptic or pyramidal friction cones
    mujoco_solver        mujoco: of constraints: Newton or CG; the same as solver=Newton or solver=CG
    max_contacts         contacts per environment for which there is room; 0: as many as were measured, and a margin
    max_rows             mujoco, steel: the same for rows of constraints; vbd: for contacts of one body
    """

    solver: str = "mujoco"
    substeps: int = 1
    iterations: int = 0
    device: str = "auto"
    gap: float = 0.01
    ke: float = 2500.0
    kd: float = 100.0
    kf: float = 1000.0
    restitution: str = "default"
    use_mujoco_contacts: bool = True
    cone: str = "elliptic"
    mujoco_solver: str = "Newton"
    max_contacts: int = 0
    max_rows: int = 0

    def __post_init__(self) -> None:
        if self.solver in MUJOCO_SOLVERS:
            if self.mujoco_solver not in (NewtonOptions.mujoco_solver, self.solver):
                raise ValueError(f"solver={self.solver} and mujoco_solver={self.mujoco_solver} contradict each other")
            object.__setattr__(self, "mujoco_solver", self.solver)
            object.__setattr__(self, "solver", "mujoco")
        one_of("solver", self.solver, (*SOLVERS, *MUJOCO_SOLVERS))
        one_of("cone", self.cone, CONES)
        one_of("mujoco_solver", self.mujoco_solver, MUJOCO_SOLVERS)
        one_of("restitution", self.restitution, ("default", "on", "off"))
        require(self, AT_LEAST_1, "substeps")
        require(self, NOT_NEGATIVE, "iterations", "max_contacts", "max_rows")
        require(self, FROM_0, "gap", "ke", "kd", "kf")

    @property
    def rebounds(self) -> bool:
        """Whether xpbd and steel honour coefficients of restitution."""
        return self.restitution == "on" or (self.restitution == "default" and self.solver == "steel")

    @property
    def own_contacts(self) -> bool:
        """Whether Newton's own collision detection makes the contacts."""
        return self.solver != "mujoco" or not self.use_mujoco_contacts
