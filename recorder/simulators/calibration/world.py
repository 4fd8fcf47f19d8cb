"""The environments on the device, and faults that are planted there for gsb-probe."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.calibration.model import LONGEST_STEP, model_of
from gpusimbench.recorder.simulators.calibration.options import CalibrationOptions, orders, places, shares
from gpusimbench.recorder.simulators.snapshot import Envs, rows_of

_RING_ROWS = 50
_RING_BYTES = 256 << 20
_SIDES = {"mirrored": 1, "turned": 0}  # of faults, the component of a velocity whose sign decides
_GRAIN = 2.0**-14  # [N]: sums are exact below 2^24 grains, 1024 N; a cube of inclined-collision weighs 0.05 N


class World:
    """N environments of a scene, in their initial state; Taichi has been started. UsageError as of model_of.

    fault  what is planted
    done   steps since the build
    first  positions, velocities and angular velocities that they begin with, [env, body, 3]
    """

    def __init__(self, scene: Scene, *, n_env: int, dt: float, options: CalibrationOptions, entropy: str) -> None:
        import taichi as ti

        from gpusimbench.recorder.simulators.calibration import kernels

        model = model_of(scene)
        n_body = len(model.start)
        self.substeps = math.ceil(dt / LONGEST_STEP - 1e-9)
        self.rows = max(1, min(_RING_ROWS, _RING_BYTES // (4 * n_env * (9 * n_body + 1))))
        self._kernels, self._options = kernels, options
        self._shape = (n_env, n_body)
        self._dt = dt / self.substeps
        self._grain = _GRAIN if options.regime == "exact" else 0.0
        self._gravity = ti.Vector(scene.gravity, ti.f32)
        self.first = [np.tile(array, (n_env, 1, 1)) for array in (model.start, model.velocity, model.spin)]
        self._state = [_vectors(array) for array in self.first]
        self._force = _vectors(np.zeros((n_env, n_body, 3), dtype=np.float32))
        self._traits, self._faces = _vectors(model.traits), _vectors(model.faces)
        self._order = _numbers(orders(options, n_env, n_body, entropy))
        self._places = _vectors(places(options, n_env))
        share = shares(options, n_env, entropy)
        self._metres = _numbers((options.shift * share).astype(np.float32))
        self._ulps = _numbers(np.rint(options.ulps * share).astype(np.int32))
        self._touching = _numbers(np.zeros(n_env, dtype=np.int32))
        self._ring: list[Any] = []
        self._still = _numbers(np.zeros(n_env, dtype=np.float32))
        self.fault = Fault(options.fault, options.ulps, options.at, n_env)
        self.done = 0

    def rehearse(self, *, storing: bool) -> None:
        """Compile the kernels of a step, and of storing it, by running them, and put the state back."""
        present = [array.to_numpy() for array in (*self._state, self._touching)]
        self._advance()
        self._shift()
        if storing:
            self.store(0)
        for array, before in zip((*self._state, self._touching), present, strict=True):
            array.from_numpy(before)

    def step(self) -> None:
        """Enqueue a step."""
        self._advance()
        self.done += 1
        if self._options.moves and self.done == self._options.at:
            self._shift()
        self.fault.after_step(self)

    def _advance(self) -> None:
        k, x_v = self._kernels, self._state[:2]
        bodies = (*self._state, self._force, self._traits, self._faces)
        if self._options.regime != "atomics":
            k.step(
                self.substeps, self._dt, self._gravity, int(self._options.contacts), self._grain, *bodies,
                self._order, self._places, self._touching,
            )  # fmt: skip
            return
        for _ in range(self.substeps):
            k.clear(self._force, self._touching)
            k.race(*x_v, self._force, self._traits, self._touching)
            k.advance_all(self._dt, self._gravity, *bodies, self._places, self._touching)

    def _shift(self) -> None:
        self._kernels.shift(self._state[0], self._metres, self._ulps)

    def store(self, row: int) -> None:
        """Enqueue: keep the present state and count as a row of the ring, which has `rows` of them."""
        if not self._ring:
            fields = (np.zeros((self.rows, *self._shape, 3), dtype=np.float32) for _ in self._state)
            counts = np.zeros((self.rows, self._shape[0]), dtype=np.int32)
            self._ring = [*map(_vectors, fields), _numbers(counts)]
        self._kernels.store(row, *self._state, self._touching, *self._ring)

    def stored(self, rows: int) -> tuple[list[NDArray[np.float32]], NDArray[np.int32]]:
        """Copies of the first rows: positions, velocities and angular velocities [row, env, body, 3]; counts."""
        *fields, counts = (array.to_numpy()[:rows] for array in self._ring)
        return fields, counts

    def state(self) -> list[NDArray[np.float32]]:
        """Copies of positions, velocities and angular velocities, [env, body, 3]."""
        return [array.to_numpy() for array in self._state]

    def nudge(self, ulps: NDArray[np.int32]) -> None:
        """Move the last body of each environment by units in the last place of its x, [env]."""
        self._kernels.shift(self._state[0], self._still, _numbers(ulps))

    def put(self, arrays: Sequence[NDArray[np.float32]], envs: Envs, done: int) -> None:
        """Give environments the rows of such arrays, [env of envs, body, 3], and the world a number of steps done."""
        for target, rows in zip(self._state, arrays, strict=True):
            whole = target.to_numpy()
            whole[rows_of(envs)] = rows
            target.from_numpy(whole)
        self.done = done

    def counts(self) -> NDArray[np.int32]:
        """Contacts of the last step, [env]."""
        return np.asarray(self._touching.to_numpy())


def _vectors(values: NDArray[np.float32]) -> Any:
    import taichi as ti

    return _filled(ti.Vector.ndarray(values.shape[-1], ti.f32, values.shape[:-1]), values)


def _numbers(values: NDArray[Any]) -> Any:
    import taichi as ti

    kind = ti.i32 if values.dtype.kind == "i" else ti.f32
    return _filled(ti.ndarray(kind, values.shape), values)


def _filled(array: Any, values: NDArray[Any]) -> Any:
    array.from_numpy(np.ascontiguousarray(values))
    return array


class Nudged(Protocol):
    """As much of a World as faults need."""

    done: int

    def nudge(self, ulps: NDArray[np.int32]) -> None: ...
    def state(self) -> list[NDArray[np.float32]]: ...


class Fault:
    """One of options.FAULTS, in a world of n_env environments: it moves the x of the last body of an environment by
    units in the last place, which contacts amplify."""

    def __init__(self, name: str, ulps: int, at: int, n_env: int) -> None:
        self._name, self._ulps, self._at, self._n_env = name, ulps, at, n_env

    def after_step(self, world: Nudged) -> None:
        """Once a step was made."""
        if world.done == self._at:
            env = np.arange(self._n_env)
            times = {"number": np.full_like(env, self._n_env), "slot": env, "relabelled": np.ones_like(env)}
            if self._name in times:
                world.nudge((self._ulps * times[self._name]).astype(np.int32))
        if self._name == "neighbours" and world.done >= self._at:
            words = np.roll(world.state()[1], -1, axis=0).view(np.uint32).reshape(self._n_env, -1)
            world.nudge((self._ulps * (np.bitwise_xor.reduce(_parity(words), axis=1))).astype(np.int32))
        if self._name in _SIDES and world.done >= self._at:
            world.nudge((self._ulps * (world.state()[1][:, -1, _SIDES[self._name]] < 0)).astype(np.int32))

    def after_uncaptured(self, world: Nudged) -> None:
        """Once steps were made that nobody captures."""
        if self._name == "capture":
            world.nudge(np.full(self._n_env, self._ulps, dtype=np.int32))

    def after(self, operation: str, world: Nudged, envs: Envs) -> None:
        """Once some environments were restored ("restored", or "process" before any step was made in this process),
        reset ("fresh") or set ("set")."""
        touched = np.ones(self._n_env, dtype=bool)
        if envs is not None:
            touched[:] = False
            touched[envs] = True
        failed = operation == "set" and self._name == "poison" and not all(np.isfinite(a).all() for a in world.state())
        if failed or (operation == "fresh" and self._name == "bystanders"):
            world.nudge((self._ulps * ~touched).astype(np.int32))
            return
        begins = (operation == "set" and not world.done) or (operation == "fresh" and envs is None)
        if operation == self._name and not begins:
            world.nudge((self._ulps * touched).astype(np.int32))


def _parity(words: NDArray[np.uint32]) -> NDArray[np.uint32]:
    for shift in (16, 8, 4, 2, 1):
        words = words ^ (words >> np.uint32(shift))
    return words & np.uint32(1)
