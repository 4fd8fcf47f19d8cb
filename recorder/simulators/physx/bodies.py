"""The states of all bodies, in the scene's order, gathered where the engine computes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene, Vector
from gpusimbench.recorder.scenes.emit.usd import env_path, prim_names
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.captured import row_index
from gpusimbench.recorder.simulators.physx import libraries
from gpusimbench.recorder.simulators.physx.session import Session, every
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.fields import BODY_FIELDS, StateField, body_fields

_COLUMNS = ("position", "orientation", "linearVelocity", "angularVelocity")
_TENSORS = ("RIGID_BODY_POSE", "RIGID_BODY_VELOCITY")  # in the order of the columns
_WIDTH = 13  # numbers of a body: position, quaternion wxyz, linear and angular velocity
_PARTS = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13))
_TRIES = 4096
_STEP = np.float32(2.0**-18)  # lengths that are tried differ from 1 by less than 0.8 %


class Bodies:
    """Moving bodies of all environments."""

    def __init__(self, session: Session, scene: Scene, *, n_env: int, device: Any) -> None:
        """device  warp.Device of the engine's arrays"""
        self._session, self._scene = session, scene
        self._device = device
        self._n_env = n_env
        self._names = [prim_names(scene)[body.name] for body in scene.moving()]
        self._source: Any = None
        self._tensors: tuple[Any, ...] = ()  # of poses and of velocities: bindings, and arrays that they are read into
        places = {body.name: index for index, body in enumerate(scene.moving())}
        self._groups = [row_index([places[name] for name in names]) for names in scene.groups().values()]
        self.count = n_env * len(self._names)

    @property
    def row_shape(self) -> tuple[int, ...]:
        """The shape of a stored state: [body, number]."""
        return self.count, _WIDTH

    def begin(self) -> None:
        """Get ready to store what steps leave: by tensors, which stay where the engine computes. A read-out goes
        through the bodies one by one on the host: on an H200, that of 110,592 bodies took longer than a step."""
        import warp as wp
        from ovphysx.types import TensorType

        if self._tensors:
            return
        paths, rows = self._paths(None), []
        with libraries.quiet():
            bindings = [
                self._session.physx.create_tensor_binding(prim_paths=paths, tensor_type=TensorType[name])
                for name in _TENSORS
            ]
        for binding in bindings:
            places = {path: row for row, path in enumerate(binding.prim_paths)}
            if places.keys() != set(paths):
                raise GsbError(f"PhysX has tensors of {len(places)} bodies, not of the {len(paths)} of the scene")
            rows.append([places[path] for path in paths])
        if rows[0] != rows[1]:
            raise GsbError("PhysX gives poses and velocities of its bodies in different orders")
        arrays = [wp.empty(binding.shape, dtype=wp.float32, device=self._device) for binding in bindings]
        self._tensors = (*bindings, *arrays, wp.array(rows[0], dtype=wp.int32, device=self._device))

    def store_step(self, stored: Any, row: int) -> None:
        """Store the state that a step has left, once `begin` was called."""
        import warp as wp

        from gpusimbench.recorder.simulators.physx import kernels

        of_poses, of_velocities, poses, velocities, source = self._tensors
        of_poses.read(poses)  # waits for what has been enqueued on the array, and for the numbers
        of_velocities.read(velocities)
        columns = (poses[:, :3], poses[:, 3:], velocities[:, :3], velocities[:, 3:])
        wp.launch(kernels.store_bodies, dim=self.count, inputs=[row, source, *columns, stored], device=self._device)

    def store(self, stored: Any, row: int) -> bool:
        """Store the present state; False where the engine does not tell it, as a GPU before the first step."""
        import warp as wp
        from ovphysx.types import SimObjectType

        from gpusimbench.recorder.simulators.physx import kernels

        with self._session.columns(SimObjectType.RIGID_BODY, _COLUMNS) as groups:
            if not groups:
                return False
            if self._source is None:
                self._source = wp.array(self._order(groups), dtype=wp.int32, device=self._device)
            wp.launch(
                kernels.store_bodies,
                dim=self.count,
                inputs=[row, self._source, *(groups[name].tensors[0] for name in _COLUMNS), stored],
                device=self._device,
            )
            wp.synchronize_device(self._device)  # the arrays are taken back when this ends
        return True

    def _order(self, groups: Mapping[str, Any]) -> NDArray[np.int32]:
        """For each body in the scene's order, environment by environment, its row in the engine's order."""
        return np.array(self._session.rows(groups.values(), self._paths(None)), dtype=np.int32)

    def _paths(self, envs: Envs) -> list[str]:
        # of the bodies of some environments, environment by environment
        return [f"{env_path(env)}/{name}" for env in every(self._n_env, envs) for name in self._names]

    def kept(self) -> dict[str, NDArray[Any]]:
        """The bodies' poses and velocities: copies [env, number] by name."""
        import warp as wp

        stored = wp.empty((1, *self.row_shape), dtype=wp.float32, device=self._device)
        self.store(stored, 0)
        return {"bodies": stored.numpy().reshape(self._n_env, -1).copy()}

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs, *, stepped: bool) -> None:
        """Write such rows, [env of envs, number].

        stepped  whether the bodies may have contacts: on a CPU they are then taken out of the simulation and put back,
                 so that the engine forgets these
        """
        from ovphysx.types import SimObjectType

        states = np.ascontiguousarray(arrays["bodies"], dtype=np.float32).reshape(-1, _WIDTH)
        position, orientation, linear, angular = (states[:, part] for part in _PARTS)
        columns = (position, to_write(np.roll(orientation, -1, axis=1)), linear, angular)
        paths = self._paths(envs)
        if stepped and not self._device.is_cuda:
            for out in (1, 0):
                flags = np.full(len(paths), out, dtype=np.uint8)
                self._session.write(SimObjectType.RIGID_BODY, paths, {"disableSimulation": flags})
        self._session.write(SimObjectType.RIGID_BODY, paths, dict(zip(_COLUMNS, columns, strict=True)))

    def merged(self, states: States, first: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """What `put` takes, of the fields' arrays [env, item, width]; they replace all of `first`, [env, number]."""
        rows = first["bodies"].reshape(len(first["bodies"]), -1, _WIDTH).copy()
        left = iter(states)
        for group in self._groups:
            for part in _PARTS:
                rows[:, group, part] = next(left)
        return {"bodies": rows.reshape(len(rows), -1)}

    def fields(self) -> tuple[StateField, ...]:
        """Layout of the state."""
        notes = {"orientation": "reordered by the recorder from PhysX's xyzw"}
        return body_fields(self._scene.groups(), "float32", notes)

    def split(self, stored: NDArray[np.float32], envs: slice = slice(None)) -> States:
        """Of a range of environments, the arrays of `fields` in stored states [step, body, number]; views, if bodies of
        a group follow each other."""
        shaped = stored.reshape(len(stored), self._n_env, -1, _WIDTH)[:, envs]
        return tuple(shaped[:, :, group, part] for group in self._groups for part in _PARTS)

    def close(self) -> None:
        """Give the engine's tensors back."""
        for binding in self._tensors[:2]:
            binding.destroy()
        self._tensors = ()


def described(scene: Scene, origins: tuple[Vector, ...], n_env: int) -> NDArray[np.float32]:
    """The state that the engine is given, [body, number], in the engine's precision: sums of origin and position are
    rounded once."""
    bodies = scene.moving()
    state = np.empty((n_env, len(bodies), _WIDTH), dtype=np.float32)
    for field, part in zip(BODY_FIELDS, _PARTS, strict=True):
        state[..., part] = np.array([getattr(body, field) for body in bodies], dtype=np.float32)
    if origins:
        state[..., :3] += np.array(origins, dtype=np.float32)[:, None]
    return state.reshape(-1, _WIDTH)


def normalised(quaternions: NDArray[np.float32]) -> NDArray[np.float32]:
    """What PhysX makes of quaternions [row, xyzw] that are written, in float32: each times 1 over its length."""
    x, y, z, w = quaternions.T
    return np.asarray(quaternions * (np.float32(1) / np.sqrt(x * x + y * y + z * z + w * w))[:, None])


def to_write(quaternions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quaternions [row, xyzw] that become the given ones when they are normalised.

    A unit quaternion in float32 is often not what its own normalisation gives. Where none is found, and where a row is
    not finite, the row is returned as it is.
    """
    found = quaternions.copy()
    left = np.flatnonzero((normalised(quaternions) != quaternions).any(axis=1) & np.isfinite(quaternions).all(axis=1))
    for attempt in range(_TRIES):
        if not left.size:
            break
        scale = 1 + _STEP * np.float32(attempt // 2 + 1) * (-1 if attempt % 2 else 1)
        wanted = quaternions[left]
        given = wanted * scale
        for _ in range(3):
            short = wanted - normalised(given)
            given = np.where(short == 0, given, np.nextafter(given, np.sign(short) * np.float32(2)))
        held = (normalised(given) == wanted).all(axis=1)
        found[left[held]] = given[held]
        left = left[~held]
    return found
