"""Energy, momentum and displacement from row to row."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.solids import (
    Displacements,
    FixedBox,
    FrictionCone,
    Rises,
    largest,
    mechanical_energy,
    square,
)
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import Check, Fact, Facts, measured
from gpusimbench.evaluator.runs.physics.states import SHARE, Setting, States
from gpusimbench.evaluator.runs.physics.world import FixedBody
from gpusimbench.schemas.text import plural

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_CLEAR = 1e-3  # from an inclined body, to count as not touching it [m]
_STORED = 0.2  # for how long contacts may keep what they give back [s]: ten time constants of MuJoCo's
_MOST_ROWS = 1000  # of that time; less of it is looked at where steps are shorter than 0.2 ms
_CHECKS = (Check.ENERGY_START, Check.ENERGY_ROW, Check.CONE, Check.PULL, Check.DISPLACEMENT)


class Balance:
    """Follows what no contact can give; `facts` when all rows were fed."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        world = setting.world
        self._mass = world.mass
        self._inertia = np.array([body.inertia for body in world.moving])
        self._reach = np.array([body.reach for body in world.moving])
        floors = [body.surface.static for body in world.floors]
        self._friction = max([*floors, *(body.surface.static for body in world.moving)])
        window = min(_MOST_ROWS, max(1, math.ceil(_STORED / setting.row_time)))
        self._rises = Rises(world.restitution, window)
        self._cone = FrictionCone(self._friction, float(self._mass.sum()) * world.gravity, setting.row_time)
        self._displacements = Displacements(setting.row_time)
        self._terms = self._resolution = 0.0
        self._why_not = ""

    def feed(self, states: States) -> None:
        """The next rows."""
        if states.linear is None or states.angular is None:
            self._why_not = "velocities were not recorded"
            return
        gravity, height = self._setting.world.gravity, states.position[..., 2]
        energy = mechanical_energy(
            height, states.linear, states.angular, mass=self._mass, inertia=self._inertia, gravity=gravity
        )
        self._rises.feed(energy)
        squared = square(states.linear)
        self._terms = max(self._terms, float(((squared + gravity * np.abs(height)) @ self._mass).max()))
        if self._setting.stride == 1:
            self._cone.feed(np.einsum("rebi,b->rei", states.linear, self._mass), self._level_only(states.position))
            self._displacements.feed(states.position, states.linear)
            self._resolution = max(self._resolution, self._setting.resolution(states.position))

    def facts(self) -> Facts:
        """Five of them."""
        setting = self._setting
        if self._why_not:
            return dict.fromkeys(_CHECKS, Missing(self._why_not))
        weight = float(self._mass.sum()) * setting.world.gravity
        rounded = setting.walk.epsilon * self._terms
        step, of = weight * min(setting.fall, setting.limit), "M g^2 dt^2, and rounding"
        if setting.limit < setting.fall:
            of = f"M g times {SHARE:.0%} of the smallest body, and rounding"
        above = measured(self._rises.above_start, tolerance=step + rounded, of=of, note=setting.sparse)
        start = {Check.ENERGY_START: above}
        if setting.sparse:
            return {**start, **dict.fromkeys(_CHECKS[1:], Missing(setting.sparse))}
        slack = self._friction * weight * setting.dt
        rise = measured(self._rises.unpaid, tolerance=step + rounded, of=of)
        return {
            **start,
            Check.ENERGY_ROW: rise,
            **self._ground(slack),
            Check.DISPLACEMENT: self._displacement(),
        }

    def _ground(self, slack: float) -> Facts:
        checks = (Check.CONE, Check.PULL)
        if not self._setting.world.floors:
            return dict.fromkeys(checks, Missing("the scene has no level floor"))
        judged = self._cone.rows > 0
        if not judged.any():
            return dict.fromkeys(checks, Missing("no row has all bodies on level ground"))
        note = f"{plural(int(self._cone.rows.sum()), 'row')}, coefficient {self._friction:g}"
        return {
            Check.CONE: measured(self._cone.excess[judged], tolerance=slack, of="mu M g dt", note=note),
            Check.PULL: measured(self._cone.pull[judged], tolerance=slack, of="mu M g dt"),
        }

    def _displacement(self) -> Fact:
        slack = self._setting.slack(self._setting.fall, self._resolution, "g dt^2, and rounding")
        if isinstance(slack, Missing):
            return slack
        return measured(self._displacements.largest, tolerance=slack.size, of=slack.of)

    def _level_only(self, position: Array) -> Mask:
        clear = np.ones(position.shape[:2], dtype=bool)
        for fixed in self._setting.world.fixed:
            clear &= self._clear_of_sides(fixed, position).all(axis=-1)
        return clear

    def _clear_of_sides(self, fixed: FixedBody, position: Array) -> Mask:
        # [row, env, body]: touches nothing of it but its upper face
        if not isinstance(fixed.solid, FixedBox):
            return np.full(position.shape[:3], fixed.level)
        beyond = np.abs(fixed.solid.local(position)) - fixed.solid.half
        apart = largest(beyond) > self._reach + _CLEAR
        if not fixed.level:
            return np.asarray(apart)
        return np.asarray(apart | (largest(beyond[..., :2]) < -self._reach))
