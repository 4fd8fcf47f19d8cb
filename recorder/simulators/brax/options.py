"""Options of Brax, and what its solvers do with the contact parameters of a scene."""

from __future__ import annotations

from dataclasses import dataclass

from gpusimbench.recorder.options import AT_LEAST_1, MEASURED, one_of, require
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.deviations import LARGER, MEAN, combination, materials, other_restitution
from gpusimbench.recorder.simulators.jax.runtime import JaxOptions
from gpusimbench.schemas.provenance import Deviation

SOLVERS = ("positional", "spring", "generalized")


@dataclass(frozen=True)
class BraxOptions(JaxOptions):
    """Options of Brax; defaults are Brax's own.

    solver              positional: position-based dynamics; spring: impulses; generalized: constraint forces in joint
                        coordinates. Positional is the default, since it alone has restitution and friction that holds
    collide_scale       positional: share of each position correction that is applied
    baumgarte_erp       spring: share of a penetration that is pushed out in a step
    restitution         positional, spring: whether contacts rebound by the scene's coefficients
    solver_iterations   generalized: iterations of projected gradient descent, at most
    solver_maxls        generalized: line-search trials in each, at most
    max_geom_pairs      pairs that a collision function keeps; 0: measured
    max_contact_points  contacts of an environment that are kept; 0: measured
    """

    solver: str = "positional"
    collide_scale: float = 1.0
    baumgarte_erp: float = 0.1
    restitution: bool = True
    solver_iterations: int = 100
    solver_maxls: int = 20
    max_geom_pairs: int = 0
    max_contact_points: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        one_of("solver", self.solver, SOLVERS)
        require(self, (lambda v: 0 < v <= 1, "a number above 0, at most 1"), "collide_scale", "baumgarte_erp")
        require(self, AT_LEAST_1, "solver_iterations", "solver_maxls")
        require(self, MEASURED, "max_geom_pairs", "max_contact_points")


_STATIC = {
    "positional": (
        "1",
        "a contact holds while its tangential correction is smaller than its normal one, whatever the material; "
        "sliding has the kinetic coefficient",
    ),
    "spring": ("none", "tangential speeds above 1 mm/s are opposed with the kinetic coefficient; nothing sticks"),
    "generalized": ("the kinetic coefficient", "there is one friction coefficient"),
}


def deviations(scene: Scene, options: BraxOptions) -> tuple[Deviation, ...]:
    """The parameters that the chosen solver honours otherwise than the scene gives them, or not at all.

    Each pair of shapes gets the larger friction of the two, by MJX's collision code; and, but for generalized, the
    mean of their restitutions, by Brax's.
    """
    solver, rebounds = options.solver, options.solver != "generalized" and options.restitution
    found = [combination("friction", LARGER, "rule of MJX, whose collision code Brax uses")]
    if rebounds:
        found.append(combination("restitution", MEAN, "Brax's rule"))
    for material in materials(scene):
        used, why = _STATIC[solver]
        if solver == "generalized":
            used = str(material.kinetic_friction)
        found.append(Deviation(f"{material.name}.static_friction", str(material.static_friction), used, why))
        if not rebounds:
            springs = "contacts are damped springs (solref, solimp), as MuJoCo's"
            why = springs if solver == "generalized" else "switched off"
            found.append(other_restitution(material, "0", why))
    return tuple(found)
