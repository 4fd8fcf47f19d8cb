"""Options of MuJoCo's physics, named as in MJCF, shared by every engine that implements it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from gpusimbench.recorder.options import ABOVE_0, AT_LEAST_1, FROM_0, names_of, one_of, parse_options, require
from gpusimbench.recorder.scenes.base import Scene

INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast", "discrete")
CONES = ("elliptic", "pyramidal")
SOLVERS = ("Newton", "CG", "PGS")

_CONDIMS = (1, 3, 4, 6)
_IMPEDANCE = (0.0001, 0.9999)  # mjMINIMP, mjMAXIMP: MuJoCo clips to these

OPTION_ATTRIBUTES = ("integrator", "cone", "solver", "iterations", "ls_iterations", "tolerance", "impratio")
GEOM_ATTRIBUTES = ("solref", "solimp", "condim")

_REPLACED = {
    "mjSOL_": "solver=Newton", "mjINT_": "integrator=implicitfast", "integrator 4": "integrator=implicitfast",
    "mjCONE_": "cone=pyramidal",
}  # fmt: skip
"""By the prefix of MuJoCo's constants, or the number of an integrator that MJX has no name for (discrete), an
option that the engines of the family know."""

STATE_COMPONENTS = (
    "time", "qpos", "qvel", "act", "history", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied", "eq_active",
    "mocap_pos", "mocap_quat", "userdata", "plugin_state", "plastic",
)  # fmt: skip
"""What mjSTATE_INTEGRATION consists of, by the names of MjData's fields. mjSTATE_FULLPHYSICS lacks the warm start."""


@dataclass(frozen=True)
class MjcfOptions:
    """Options of MuJoCo's physics.

    integrator     Euler, RK4, implicit, implicitfast or discrete
    cone           of friction: elliptic or pyramidal
    solver         of constraints: Newton, CG or PGS
    iterations     of the solver, at most
    ls_iterations  of the solver's line search, at most
    tolerance      improvement at which the solver stops; 0: it makes all its iterations
    impratio       of friction to normal impedance of elliptic cones
    solref         of contacts, and of the pin that closes a scene's loop, two numbers: time constant [s] and damping
                   ratio, or, both negative, stiffness and damping
    solimp         of the same, five numbers: impedance at no penetration and at `width`, both above 0 and below 1;
                   width [m]; midpoint, above 0 and below 1; power, at least 1
    condim         dimensions of a contact: 1 (no friction), 3 (sliding), 4 (and torsional) or 6 (and rolling friction)

    ValueError for a value that MuJoCo would replace by another.
    """

    integrator: str = "implicitfast"
    cone: str = "elliptic"
    solver: str = "Newton"
    iterations: int = 100
    ls_iterations: int = 50
    tolerance: float = 1e-8
    impratio: float = 1.0
    solref: str = "0.02 1"
    solimp: str = "0.9 0.95 0.001 0.5 2"
    condim: int = 3

    def __post_init__(self) -> None:
        for name, allowed in (("integrator", INTEGRATORS), ("cone", CONES), ("solver", SOLVERS)):
            one_of(name, getattr(self, name), allowed)
        require(self, AT_LEAST_1, "iterations", "ls_iterations")
        require(self, FROM_0, "tolerance")
        require(self, ABOVE_0, "impratio")
        if self.condim not in _CONDIMS:
            raise ValueError(f"condim is one of {', '.join(map(str, _CONDIMS))}, not {self.condim}")
        solref = self._numbers("solref", 2)
        if not (min(solref) > 0 or max(solref) < 0):
            raise ValueError(f"solref is two numbers above 0, or two below 0, not '{self.solref}'")
        least, most, width, midpoint, power = self._numbers("solimp", 5)
        low, high = _IMPEDANCE
        if not all(low <= value <= high for value in (least, most, midpoint)):
            raise ValueError(f"solimp's first, second and fourth number are from {low} to {high}, not '{self.solimp}'")
        if width < 0 or power < 1:
            raise ValueError(f"solimp's width is at least 0 and its power at least 1, not '{self.solimp}'")

    def _numbers(self, name: str, count: int) -> list[float]:
        text = getattr(self, name)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            raise ValueError(f"{name} is a list of numbers, not '{text}'") from None
        if len(values) != count or not all(map(math.isfinite, values)):
            raise ValueError(f"{name} is {count} finite numbers, not '{text}'")
        return values


def own_options(scene: Scene, given: Mapping[str, str] = MappingProxyType({})) -> MjcfOptions:
    """Those with which another engine's model is compiled: the given ones, and what a model file says itself."""
    options: MjcfOptions = parse_options("mujoco", MjcfOptions, scene.options(given, names_of(MjcfOptions)))
    return options


def replacement(refusal: str) -> str:
    """What to do about a solver, an integrator or a cone that an engine refuses by MuJoCo's name, to be added to the
    refusal: the option that replaces it. Empty where the refusal names something else."""
    options = dict.fromkeys(f"--option {option}" for prefix, option in _REPLACED.items() if prefix in refusal)
    return f"; {' '.join(options)} replaces the model's own" if options else ""
