"""Friction of cubes that slide alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.physics.rolling import FEWEST_ROWS, Stretches
from gpusimbench.evaluator.metrics.physics.solids import FixedBox, nearest, rotations
from gpusimbench.evaluator.metrics.physics.vectors import largest, length
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.runs.physics.facts import Fact, measured
from gpusimbench.evaluator.runs.physics.setting import Setting
from gpusimbench.evaluator.runs.physics.states import States
from gpusimbench.evaluator.runs.physics.world import FixedBody

_LEVEL = float(np.cos(np.radians(2.0)))  # of a face, to count as flat on the ground
_HOVER = 1e-3  # between the heights of a cube that slides and of one that lies [m]
_SPIN = 0.3  # speed of a corner about the centre over the speed, to count as sliding straight
_SHARE = 0.05  # of the coefficient: a spin of 30 % takes 2 %, a tilt of 2 degrees lifts it for a while

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


class Slides:
    """Collects stretches in which a cube slides."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        bodies = setting.world.moving
        self._cubes = [i for i, body in enumerate(bodies) if body.half]
        self._reach = np.array([body.reach for body in bodies])
        self._half = np.array([bodies[i].half for i in self._cubes])
        self._floors = [body for body in setting.world.fixed if body.level]
        pairs = [(bodies[i].surface.kinetic, floor.surface.kinetic) for i in self._cubes for floor in self._floors]
        self._bounds = min((min(pair) for pair in pairs), default=0.0), max((max(pair) for pair in pairs), default=0.0)
        self._stretches: Stretches | None = None

    def feed(self, states: States) -> None:
        """The next rows."""
        if states.linear is None or states.angular is None or states.orientation is None or not self._cubes:
            return
        if self._setting.sparse:
            return
        envs, bodies = states.position.shape[1:3]
        linear = states.linear[:, :, self._cubes]
        slides = self._candidates(states, linear)
        row, env = np.nonzero(slides.any(axis=2))
        if len(row):
            closest, _ = nearest(states.position[row, env])
            slides[row, env] &= closest[:, self._cubes] > self._reach[self._cubes] + self._reach.max()
            which = np.nonzero(slides)
            turn = rotations(states.orientation[:, :, self._cubes][which])
            slides[which] &= np.abs(turn[:, 2]).max(axis=-1) > _LEVEL
        if self._stretches is None:
            gravity, dt = self._setting.world.gravity, self._setting.dt
            self._stretches = Stretches(envs * len(self._cubes), gravity=gravity, dt=dt)
        for index in range(len(slides)):
            self._stretches.feed(linear[index].reshape(-1, 3), slides[index].reshape(-1))

    def fact(self) -> Fact:
        """The coefficient, once all rows were fed."""
        if self._setting.sparse:
            return Missing(self._setting.sparse)
        if not self._floors or not self._cubes:
            return Missing("no cube can slide on level ground")
        if self._stretches is not None:
            self._stretches.end()
        found = self._stretches.friction if self._stretches else []
        if not found:
            return Missing(f"no cube slid flat, straight and apart from all others for {FEWEST_ROWS} rows")
        low, high = self._bounds
        return measured(
            found, low=low, high=high, tolerance=_SHARE * high, of="5 % of the larger coefficient",
            note=f"{len(found)} stretches; the rule for a pair is not part of the scene",
        )  # fmt: skip

    def _candidates(self, states: States, linear: Array) -> Mask:
        # fast enough, straight enough, at the right height; what is dear to know comes after
        assert states.angular is not None
        speed = length(linear[..., :2])
        spin = length(states.angular[:, :, self._cubes]) * self._reach[self._cubes]
        fast = speed > self._bounds[1] * self._setting.world.gravity * self._setting.dt
        return np.asarray(fast & (spin < _SPIN * speed) & self._on_a_floor(states.position[:, :, self._cubes]))

    def _on_a_floor(self, place: npt.NDArray[np.float64]) -> Mask:
        found = np.zeros(place.shape[:3], dtype=bool)
        for floor in self._floors:
            found |= self._lies_on(floor, place)
        return found

    def _lies_on(self, floor: FixedBody, place: npt.NDArray[np.float64]) -> Mask:
        near = np.abs(place[..., 2] - floor.top - self._half) < _HOVER
        if isinstance(floor.solid, FixedBox):
            near &= largest(np.abs(floor.solid.local(place)[..., :2]) - floor.solid.half[:2]) < 0
        return np.asarray(near)
