"""What was measured of one run, as plain numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

from gpusimbench.evaluator.missing import Missing


class Revision(Enum):
    """A version of the tolerances; those of a version never change. docs/physics.md says how they differ.

    FIRST   "physics-1": tolerances of the step and the number type alone
    SECOND  "physics-2": no tolerance of a length is more than a share of the smallest body that moves
    """

    FIRST = "physics-1"
    SECOND = "physics-2"


NEWEST = Revision.SECOND
"""By which every command judges."""


class Check(Enum):
    """What is looked at; the first of each value is its name in the JSON.

    title     as tables show it
    unit      of the measured number; empty for ratios and counts
    demanded  whether mechanics demands it; else it says only whether the scene was at rest at its sample time
    """

    FINITE = ("finite", "environments that blew up", "")
    ROLLING = ("rolling_acceleration", "acceleration of the rolling ball", "m/s2")
    FOOT_SPEED = ("foot_speed", "speed of the ball at the foot of the slope", "m/s")
    SLIP = ("rolling_slip", "slip of the ball at its contact", "m/s")
    FALL = ("fall_acceleration", "acceleration of free fall", "m/s2")
    FALL_LEAD = ("fall_lead", "first-order error of the fall in g dt", "")
    FALL_SHAPE = ("fall_deformation", "deformation while falling", "m")
    IMPACT_TIME = ("impact_time", "time of the impact", "s")
    IMPACT_SPEED = ("impact_speed", "speed at the impact", "m/s")
    REBOUND = ("rebound", "rebound over the speed at the impact", "")
    ENERGY_START = ("energy_above_start", "energy above the initial energy", "J")
    ENERGY_ROW = ("energy_rise", "energy gained beyond earlier losses", "J")
    CONE = ("friction_cone", "horizontal impulse beyond friction limit", "N s")
    PULL = ("ground_pull", "downward contact impulse", "N s")
    SLIDING = ("sliding_friction", "friction of sliding cubes", "")
    DISPLACEMENT = ("displacement", "displacement not explained by velocity", "m")
    DEPTH_REST = ("depth_at_rest", "penetration into fixed bodies at rest", "m")
    DEPTH_EVER = ("depth_ever", "max penetration into fixed bodies", "m")
    PAIR_REST = ("pair_depth_at_rest", "penetration between bodies at the end", "m")
    PAIR_EVER = ("pair_depth_ever", "max penetration between bodies (at least)", "m")
    SANK = ("sank", "bodies through the floor per env", "")
    END_SPEED = ("end_speed", "fastest cube on the floor at the end", "m/s", False)
    END_SPIN = ("end_spin", "fastest spin of a cube on the floor at the end", "rad/s", False)
    JOINT_LIMIT = ("joint_limit", "joint angle beyond its limits", "rad")

    def __init__(self, key: str, title: str, unit: str, demanded: bool = True) -> None:
        self.key, self.title, self.unit, self.demanded = key, title, unit, demanded


@dataclass(frozen=True)
class Measured:
    """A check of one run that could be made.

    mean, least, most  of the values that are finite; None where none is
    count              how many values there are: environments, or stretches of sliding
    low, high          what mechanics allows, in the check's unit; None where that side is open
    tolerance          what the method's step and its number type may add on either side; `of` says by what formula
    broken             how many values are beyond low - tolerance or high + tolerance
    of                 the formula of the tolerance, in words
    note               what else was found
    """

    mean: float | None
    least: float | None
    most: float | None
    count: int
    low: float | None
    high: float | None
    tolerance: float
    broken: int
    of: str
    note: str = ""


Fact = Measured | Missing
"""What a check found; Missing where it does not apply to the run."""

Facts = Mapping[Check, Fact]


@dataclass(frozen=True)
class LawValues:
    """One law in one run.

    key        for JSON
    title      as tables show it
    unit       of the values
    measured   by environment; NaN where the motion did not take place
    predicted  by environment, in closed form; Missing where the engine was not told what decides it: it is measured
               without a verdict
    tolerance  that the step may add to the mean on either side, by the formula `of`
    slopes     by parameter: the derivative of the predicted value, mean over environments, in `unit` for a share of 1
               of the parameter ("mass", "middle moment", "friction", "restitution", "gravity", "rocker's mass",
               "coupler's length", "rocker's length"), or for 1 N m s/rad of a joint's ("damping") or 1/s of a body's
               ("angular damping"); 0 where it has no effect
    absent     why an environment has no value; empty where each has one
    uneven     by parameter: how unevenly a change of it moves environments (unevenness in canonical/motion.py), where
               that is more than the coefficient of variation of the predicted values
    """

    key: str
    title: str
    unit: str
    measured: tuple[float, ...]
    predicted: tuple[float, ...] | Missing
    tolerance: float
    of: str
    slopes: tuple[tuple[str, float], ...]
    absent: str = ""
    uneven: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class LawCounts:
    """One law in one run that says that all outcomes of a throw are equally likely.

    key     for JSON
    title   as tables show it
    counts  of each outcome, over all environments
    of      throws, those without an outcome included
    absent  why a throw has no outcome
    """

    key: str
    title: str
    counts: tuple[int, ...]
    of: int
    absent: str


@dataclass(frozen=True)
class PhysicsFacts:
    """All that was measured of one run.

    scene     its name
    n_env     environments of the run
    envs      first and last environment of each range that was looked at
    facts     of every check, in their order; Missing where nothing can be said of the run
    revision  by whose tolerances
    laws      of motions that are known in closed form; empty where the scene has none, Missing where none could be
              measured
    """

    scene: str
    n_env: int
    envs: tuple[tuple[int, int], ...]
    facts: Facts | Missing
    revision: Revision = NEWEST
    laws: tuple[LawValues | LawCounts, ...] | Missing = ()

    @property
    def looked_at(self) -> int:
        """Environments that the facts are of."""
        return sum(last - first + 1 for first, last in self.envs)

    @property
    def exactness(self) -> str:
        """ "exact" where all environments were looked at, else "sampled"."""
        return "exact" if self.looked_at == self.n_env else "sampled"


def measured(
    values: Iterable[float], *, low: float | None = None, high: float | None = 0.0, tolerance: float, of: str,
    note: str = "",
) -> Fact:  # fmt: skip
    """The result of a check, from its values; values that are not finite count as broken.

    low, high  what mechanics allows; by default an excess, which is at most zero
    """
    found = [float(value) for value in values]
    finite = [value for value in found if abs(value) < float("inf")]
    if not found:
        return Missing("there is nothing to measure")
    least = None if low is None else low - tolerance
    most = None if high is None else high + tolerance
    held = [v for v in finite if (least is None or v >= least) and (most is None or v <= most)]
    mean = sum(finite) / len(finite) if finite else None
    return Measured(
        mean, min(finite, default=None), max(finite, default=None), len(found), low, high, tolerance,
        len(found) - len(held), of, note,
    )  # fmt: skip
