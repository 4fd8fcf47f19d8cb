"""Friction of cubes that slide alone."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from evaluator.metrics.physics.sliding import FEWEST_ROWS, sliding_friction
from evaluator.metrics.physics.solids import FixedBox, nearest, rotations
from evaluator.physics.facts import Check, Fact, NotMeasured, measured
from evaluator.physics.setting import Setting
from evaluator.physics.states import States
from evaluator.physics.world import FixedBody

_LEVEL = float(np.cos(np.radians(2.0)))  # of a face, to count as flat on the ground
_HOVER = 1e-3  # between the heights of a cube that slides and of one that lies [m]
_SPIN = 0.1  # speed of a corner about the centre over the speed, to count as sliding straight
_SHARE = 0.05  # of the coefficient: a spin of 10 % takes 1 %, a tilt of 2 degrees lifts it for a while

Mask = npt.NDArray[np.bool_]


class Slides:
    """Collects stretches in which a cube slides; one that is cut by the rows read at a time counts as two."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        bodies = setting.world.moving
        self._cubes = [i for i, body in enumerate(bodies) if body.half]
        self._reach = np.array([body.reach for body in bodies])
        self._half = np.array([bodies[i].half for i in self._cubes])
        self._floors = [body for body in setting.world.fixed if body.level]
        pairs = [(bodies[i].surface.kinetic, floor.surface.kinetic) for i in self._cubes for floor in self._floors]
        self._bounds = min((min(pair) for pair in pairs), default=0.0), max((max(pair) for pair in pairs), default=0.0)
        self._found: list[float] = []

    def feed(self, states: States) -> None:
        """The next rows."""
        if states.linear is None or states.angular is None or states.orientation is None or not self._cubes:
            return
        if self._setting.sparse:
            return
        rows, envs, bodies = states.position.shape[:3]
        place, linear = states.position[:, :, self._cubes], states.linear[:, :, self._cubes]
        speed = np.linalg.norm(linear[..., :2], axis=-1)
        gravity, dt = self._setting.world.gravity, self._setting.dt
        slides = speed > self._bounds[1] * gravity * dt
        slides &= np.linalg.norm(states.angular[:, :, self._cubes], axis=-1) * self._reach[self._cubes] < _SPIN * speed
        slides &= self._on_a_floor(place)
        if not slides.any():
            return
        closest, _ = nearest(states.position.reshape(rows * envs, bodies, 3))
        slides &= closest.reshape(rows, envs, bodies)[:, :, self._cubes] > self._reach[self._cubes] + self._reach.max()
        tilt = np.abs(rotations(states.orientation[:, :, self._cubes])[..., 2, :]).max(axis=-1)
        slides &= tilt > _LEVEL
        flat = rows, envs * len(self._cubes)
        self._found += sliding_friction(
            linear.reshape(*flat, 3), slides.reshape(flat), gravity=gravity, dt=dt
        ).tolist()  # fmt: skip

    def fact(self) -> Fact:
        """The coefficient, once all rows were fed."""
        if self._setting.sparse:
            return NotMeasured(Check.SLIDING, self._setting.sparse)
        if not self._floors or not self._cubes:
            return NotMeasured(Check.SLIDING, "no cube can slide on level ground")
        if not self._found:
            why = f"no cube slid flat, straight and apart from all others for {FEWEST_ROWS} rows"
            return NotMeasured(Check.SLIDING, why)
        low, high = self._bounds
        return measured(
            Check.SLIDING, self._found, low=low, high=high, tolerance=_SHARE * high, of="5 % of the larger coefficient",
            note=f"{len(self._found)} stretches; the rule for a pair is not part of the scene",
        )  # fmt: skip

    def _on_a_floor(self, place: npt.NDArray[np.float64]) -> Mask:
        found = np.zeros(place.shape[:3], dtype=bool)
        for floor in self._floors:
            found |= self._lies_on(floor, place)
        return found

    def _lies_on(self, floor: FixedBody, place: npt.NDArray[np.float64]) -> Mask:
        near = np.abs(place[..., 2] - floor.top - self._half) < _HOVER
        if isinstance(floor.solid, FixedBox):
            near &= (np.abs(floor.solid.local(place)[..., :2]) < floor.solid.half[:2]).all(axis=-1)
        return np.asarray(near)
