"""What all checks of a run share: its states, its world, its step, and the tolerances that follow from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Revision
from gpusimbench.evaluator.runs.physics.states import Walk
from gpusimbench.evaluator.runs.physics.world import World
from gpusimbench.schemas.initial import drawn
from gpusimbench.schemas.text import ordinal

SHARE = 0.05
"""Of the smallest body, to which physics-2 limits tolerances of lengths: docs/physics.md says why."""


@dataclass(frozen=True)
class Slack:
    """A tolerance of a length [m], and its formula in words."""

    size: float
    of: str


@dataclass(frozen=True)
class Setting:
    """A run that is being looked at.

    walk         over its states
    world        its scene
    dt           step of the simulator [s]
    stride       steps between rows
    sample_time  when the scene's outcome is read [s]
    initial      how the run began, as RunConfiguration.initial; empty: in the scene's first state
    revision     of the tolerances
    """

    walk: Walk
    world: World
    dt: float
    stride: int
    sample_time: float
    initial: str = ""
    revision: Revision = NEWEST

    @property
    def begun_otherwise(self) -> Missing | None:
        """Why nothing can be said of a motion that is known from the scene's first state; None where it can."""
        return Missing("the run did not begin in the scene's first state") if self.initial else None

    @property
    def row_time(self) -> float:
        """Simulated time from row to row [s]."""
        return self.dt * self.stride

    @property
    def fall(self) -> float:
        """g dt^2 [m]: how far gravity moves a body from rest in a step of semi-implicit Euler."""
        return self.world.gravity * self.dt**2

    @property
    def limit(self) -> float:
        """The largest tolerance of a length [m]: SHARE of the smallest edge or diameter of a body that moves."""
        if self.revision is Revision.FIRST:
            return math.inf
        return SHARE * min(2.0 * (body.radius or body.half) for body in self.world.moving)

    def slack(self, method: float, rounding: float, of: str) -> Slack | Missing:
        """The tolerance of a length, at most `limit`; Missing where rounding alone is more.

        method    what the step accounts for [m], by the formula `of`
        rounding  what the number type accounts for [m]
        """
        coarse = self.too_coarse(rounding)
        return self.capped(method + rounding, of) if coarse is None else coarse

    def too_coarse(self, rounding: float) -> Missing | None:
        """Why lengths that are rounded by so much [m] can show nothing; None where they can."""
        if rounding <= self.limit:
            return None
        return Missing(
            f"positions are rounded by up to {rounding:.2g} m, more than {SHARE:.0%} of the smallest body "
            f"({self.limit:.2g} m)"
        )

    def capped(self, length: float, of: str) -> Slack:
        """A tolerance [m] by the formula `of`, or `limit` where that is less."""
        if length > self.limit:
            return Slack(self.limit, f"{SHARE:.0%} of the smallest body, less than {of}")
        return Slack(length, of)

    def resolution(self, place: npt.NDArray[np.float64]) -> float:
        """What the number type may add to a distance between two of some places [m], shape [...], in env frames.

        Each coordinate was recorded from the environment's origin, rounded by half a unit in the last place: eps times
        the largest for two of them, less than twice that for three coordinates.
        """
        largest = float(np.abs(place).max(initial=0.0))
        return 2.0 * self.walk.epsilon * (self.walk.offset + largest)

    @property
    def fastest(self) -> float | Missing:
        """sqrt(2 g H) [m/s], with H from the lowest floor to the highest centre at the start, and what was drawn for
        the velocities; or why there is no bound."""
        spread = drawn(self.initial)
        if spread is None and (otherwise := self.begun_otherwise) is not None:
            return otherwise
        tops = [body.top for body in self.world.floors]
        if not tops:
            return Missing("the scene has no level floor")
        highest = max(body.start[2] for body in self.world.moving)
        fall = float((2.0 * self.world.gravity * max(0.0, highest - min(tops))) ** 0.5)
        return fall if spread is None else float(np.hypot(fall, 3**0.5 * spread.spread))

    @property
    def sparse(self) -> str:
        """Why nothing can be said of what happens between rows; empty where every step was recorded."""
        return "" if self.stride == 1 else f"only every {ordinal(self.stride)} state was recorded"
