"""How deep bodies are in fixed ones and in each other, where they end, and how many cubes went through the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gpusimbench.evaluator.metrics.lost_cubes import Sinking, may_have_sunk
from gpusimbench.evaluator.metrics.physics.solids import (
    Fixed,
    FixedBox,
    box_distance,
    corner_depth,
    largest,
    length,
    nearest,
    overlap,
    rotations,
    sphere_depth,
    square,
)
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.evaluator.read.scene import radii_of, supports_of
from gpusimbench.evaluator.runs.physics.facts import Check, Fact, Facts, measured
from gpusimbench.evaluator.runs.physics.states import Setting, States
from gpusimbench.evaluator.runs.positions import OutcomeArray, in_env_frame, no_states, outcome_of

Array = npt.NDArray[np.float64]

REST = 0.01
"""Speed of every point of a body that counts as lying still [m/s]."""

_CHECKS = (Check.DEPTH_REST, Check.DEPTH_EVER, Check.PAIR_REST, Check.PAIR_EVER)

_ALONE = Missing("a single body moves")

Mask = npt.NDArray[np.bool_]

_ROW_BYTES = 16 << 20  # of positions read at a time


class Depths:
    """Follows the deepest of all bodies; `facts` when all rows were fed."""

    def __init__(self, setting: Setting) -> None:
        self._setting = setting
        bodies = setting.world.moving
        self._balls = [i for i, body in enumerate(bodies) if body.radius]
        self._cubes = [i for i, body in enumerate(bodies) if body.half]
        self._half = np.array([bodies[i].half for i in self._cubes])
        self._radius = np.array([bodies[i].radius for i in self._balls])
        self._fixed = self._pair = np.zeros(0)  # of what touches nothing, zero
        self._resolution = 0.0
        self._last: States | None = None

    def feed(self, states: States) -> None:
        """The next rows."""
        first = self._last is None
        self._last = states
        if states.orientation is None:
            return
        self._resolution = max(self._resolution, self._setting.resolution(states.position))
        distinct, which = states.distinct, states.which  # what is the same is looked at once
        turn = rotations(states.orientation[:, distinct][:, :, self._cubes])
        fixed = self._in_fixed(states.position[:, distinct], turn).max(axis=(0, 2))[which]
        pair = self._in_each_other(states.position[:, distinct], turn)[which]
        self._fixed = np.maximum(0.0 if first else self._fixed, fixed)
        self._pair = np.maximum(0.0 if first else self._pair, pair)

    def facts(self) -> Facts:
        """Four of them."""
        setting, last = self._setting, self._last
        if last is None or last.orientation is None:
            return dict.fromkeys(_CHECKS, Missing("orientations were not recorded"))
        return {**self._at_rest(last), **self._ever(setting)}

    def _ever(self, setting: Setting) -> Facts:
        checks, fastest = (Check.DEPTH_EVER, Check.PAIR_EVER), setting.fastest
        if isinstance(fastest, Missing):
            return dict.fromkeys(checks, fastest)
        if (coarse := setting.too_coarse(self._resolution)) is not None:
            return dict.fromkeys(checks, coarse)
        slack = setting.capped(fastest * setting.dt + setting.fall, "sqrt(2 g H) dt + g dt^2")
        of, note = slack.of, setting.sparse
        pair = measured(self._pair, tolerance=slack.size, of=of, note=note)
        return {
            Check.DEPTH_EVER: measured(self._fixed, tolerance=slack.size, of=of, note=note),
            Check.PAIR_EVER: pair if len(setting.world.moving) > 1 else _ALONE,
        }

    def _at_rest(self, last: States) -> Facts:
        checks = (Check.DEPTH_REST, Check.PAIR_REST)
        if last.linear is None or last.angular is None or last.orientation is None:
            return dict.fromkeys(checks, Missing("velocities were not recorded"))
        reach = np.array([body.reach for body in self._setting.world.moving])
        speed = np.linalg.norm(last.linear[-1], axis=-1) + np.linalg.norm(last.angular[-1], axis=-1) * reach
        still = speed < REST
        if not still.any():
            return dict.fromkeys(checks, Missing(f"nothing moves slower than {REST:g} m/s at the end"))
        end = last.position[-1:]
        turn = rotations(last.orientation[-1:, :, self._cubes])
        deep = np.where(still, self._in_fixed(end, turn)[0], 0.0).max(axis=1, initial=0.0)
        note = f"{np.count_nonzero(still)} of {still.size} bodies are at rest"
        rounding = self._setting.resolution(end[0][still])
        slack = self._setting.slack(self._setting.fall, rounding, "g dt^2, and rounding")
        if isinstance(slack, Missing):
            return dict.fromkeys(checks, slack)
        size, several = slack.size, still.sum(axis=1) > 1
        fixed: Fact = Missing("the scene has no fixed bodies")
        if self._setting.world.fixed:
            deepest = deep[still.any(axis=1)]
            fixed = measured(deepest, tolerance=size, of=slack.of, note=note)
        pair: Fact = Missing("no two bodies of an environment are at rest at the end")
        if len(self._setting.world.moving) == 1:
            pair = _ALONE
        elif several.any():
            pairs = self._pairs_at_rest(end[0][several], turn[0][several], still[several])
            pair = measured(pairs, tolerance=size, of=slack.of)
        return {Check.DEPTH_REST: fixed, Check.PAIR_REST: pair}

    def _in_fixed(self, position: Array, turn: Array) -> Array:
        # [row, env, body]
        deepest = np.full(position.shape[:3], -np.inf)
        rows, envs = position.shape[:2]
        for fixed in self._setting.world.fixed:
            for ball in self._balls:
                depth = sphere_depth(fixed.solid, position[:, :, ball], self._setting.world.moving[ball].radius)
                deepest[:, :, ball] = np.maximum(deepest[:, :, ball], depth)
            if self._cubes:
                depth = self._cube_depth(fixed.solid, position[:, :, self._cubes], turn)
                index = np.ix_(range(rows), range(envs), self._cubes)
                deepest[index] = np.maximum(deepest[index], depth)
        return deepest

    def _cube_depth(self, solid: Fixed, centre: Array, turn: Array) -> Array:
        half = np.broadcast_to(self._half[:, None], centre.shape)
        flat = corner_depth(solid, centre.reshape(-1, 3), turn.reshape(-1, 3, 3), half.reshape(-1, 3))
        return flat.reshape(centre.shape[:-1])

    def _in_each_other(self, position: Array, turn: Array) -> Array:
        # [env]; of cubes by the spheres inside them, so at least that deep
        rows, envs = position.shape[:2]
        deepest = np.full((rows, envs), -np.inf)
        cubes = position[:, :, self._cubes]
        if len(self._cubes) > 1:
            _, closest = nearest(cubes.reshape(rows * envs, -1, 3))
            deepest = 2 * self._half.min() - closest.reshape(rows, envs)
        balls = position[:, :, self._balls]
        for ball, radius in enumerate(self._radius):
            between = radius + self._radius[:ball] - length(balls[:, :, ball, None] - balls[:, :, :ball])
            deepest = np.maximum(deepest, between.max(axis=-1, initial=-np.inf))
            away = balls[:, :, ball, None] - cubes
            close = square(away) < (radius + np.sqrt(3.0) * self._half) ** 2
            if close.any():
                local = np.einsum("ni,nij->nj", away[close], turn[close])
                half = np.broadcast_to(self._half, close.shape)[close]
                depth = np.full(close.shape, -np.inf)
                depth[close] = radius - box_distance(local, half[:, None])
                deepest = np.maximum(deepest, depth.max(axis=-1))
        return np.asarray(deepest.max(axis=0))

    def _pairs_at_rest(self, position: Array, turn: Array, still: Mask) -> list[float]:
        # exact, of bodies that are both at rest; positions [env, body, 3], rotations of cubes [env, cube, 3, 3]
        found = []
        for place, rotation, rests in zip(position, turn, still, strict=True):
            cubes, balls = place[self._cubes], place[self._balls]
            first, second = np.triu_indices(len(cubes), 1)
            near = length(cubes[first] - cubes[second]) < np.sqrt(3.0) * (self._half[first] + self._half[second])
            near &= rests[self._cubes][first] & rests[self._cubes][second]
            boxes = [
                (cubes[i], rotation[i], np.repeat(self._half[i][:, None], 3, axis=1))
                for i in (first[near], second[near])
            ]
            depths = [overlap(boxes[0], boxes[1])]
            for ball in np.flatnonzero(rests[self._balls]):
                radius, centre = self._radius[ball], balls[ball]
                between = radius + self._radius[:ball] - length(centre - balls[:ball])
                local = np.einsum("ni,nij->nj", centre - cubes, rotation)
                inside = radius - box_distance(local, self._half[:, None])
                depths += [between[rests[self._balls][:ball]], inside[rests[self._cubes]]]
            found.append(float(np.concatenate(depths).max(initial=0.0)))
        return found


def end_facts(setting: Setting, last: States) -> Facts:
    """The fastest motion and the fastest spin of cubes above a floor, once the scene's sample time is over."""
    checks = (Check.END_SPEED, Check.END_SPIN)
    time = float(last.step[-1]) * setting.dt
    if time < setting.sample_time * (1.0 - 1e-9):
        why = f"the states end at {time:g} s, before {setting.sample_time:g} s"
        return dict.fromkeys(checks, Missing(why))
    if last.linear is None or last.angular is None:
        return dict.fromkeys(checks, Missing("velocities were not recorded"))
    cubes = [i for i, body in enumerate(setting.world.moving) if body.half]
    on_floor = _above_a_floor(setting, last.position[-1][:, cubes])
    if not on_floor.any():
        return dict.fromkeys(checks, Missing("no cube is above a floor at the end"))
    judged = on_floor.any(axis=1)
    speed, spin = (np.where(on_floor, length(of[-1][:, cubes]), 0.0) for of in (last.linear, last.angular))
    note = f"{np.count_nonzero(on_floor)} of {on_floor.size} cubes are above a floor"
    slowest = REST / max(setting.world.moving[i].reach for i in cubes)
    spins = f"{np.count_nonzero(spin > slowest)} of them spin"
    return {
        Check.END_SPEED: measured(speed.max(axis=1)[judged], tolerance=REST, of="1 cm/s", note=note),
        Check.END_SPIN: measured(spin.max(axis=1)[judged], tolerance=slowest, of="1 cm/s of a corner", note=spins),
    }


def _above_a_floor(setting: Setting, place: Array) -> Mask:
    # [env, cube]
    found = np.zeros(place.shape[:2], dtype=bool)
    for floor in setting.world.floors:
        above = place[..., 2] >= floor.top
        if isinstance(floor.solid, FixedBox):
            above &= largest(np.abs(floor.solid.local(place)[..., :2]) - floor.solid.half[:2]) <= 0
        found |= above
    return found


@dataclass(frozen=True)
class Sunk:
    """Cubes that went through what should have held them up, by the last captured step.

    per_env     cubes in each environment
    cubes       that an environment has
    last_step   that they were followed to
    first_step  at which the first was through; None where none was
    """

    per_env: tuple[int, ...]
    cubes: int
    last_step: int
    first_step: int | None


def count_sunk(recording: Recording) -> Sunk | Missing:
    """Count the sunk cubes of each environment; Missing says why they cannot be counted."""
    fields = outcome_of(recording)
    if isinstance(fields, Missing):
        return fields
    if "size" in recording.configuration.varied:
        return Missing("sizes of bodies differ from environment to environment (--vary)")
    array = OutcomeArray(recording, fields)
    if len(array) < 2:
        return no_states(recording)
    supports = supports_of(recording)
    if not supports:
        return Missing("scene.json describes no level surface (a fixed plane or box) that bodies could go through")
    last = in_env_frame(recording, array.field, array.at_step(int(array.steps[-1])))
    if last.shape[-1] < 3:
        return Missing("heights were not recorded")
    n_env, cubes = last.shape[:2]
    last_step = int(array.steps[-1])
    lost = Missing("a position is not finite at the last captured step: whether that body sank is not known")
    known = bool(np.isfinite(last).all())
    radii = np.concatenate([radii_of(recording, field) for field in fields])
    if not may_have_sunk(last, supports, radii):
        return Sunk((0,) * n_env, cubes, last_step, None) if known else lost
    following = Sinking(in_env_frame(recording, array.field, array.at_step(int(array.steps[0]))), supports, radii)
    count = max(1, _ROW_BYTES // last.nbytes)
    for begin in range(1, len(array), count):
        for row in array.read(slice(begin, begin + count)):
            following.feed(in_env_frame(recording, array.field, row))
    found = following.sank
    if not (known or found.any()):
        return lost
    first = int(array.steps[following.since[found].min()]) if found.any() else None
    return Sunk(tuple(np.count_nonzero(found, axis=1).tolist()), cubes, last_step, first)
