"""The states of all bodies, in the scene's order, gathered where the engine computes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene, Vector
from gpusimbench.recorder.scenes.emit.usd import env_path, prim_names
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.physx.session import Session
from gpusimbench.schemas.fields import BODY_FIELDS, StateField, body_fields

_COLUMNS = ("position", "orientation", "linearVelocity", "angularVelocity")
_WIDTH = 13  # numbers of a body: position, quaternion wxyz, linear and angular velocity
_PARTS = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13))


class Bodies:
    """Moving bodies of all environments."""

    def __init__(self, session: Session, scene: Scene, *, n_env: int, device: Any) -> None:
        """device  warp.Device of the engine's arrays"""
        self._session = session
        self._device = device
        self._n_env = n_env
        self._names = [prim_names(scene)[body.name] for body in scene.moving()]
        self._source: Any = None
        places = {body.name: index for index, body in enumerate(scene.moving())}
        self._groups = [np.array([places[name] for name in names]) for names in scene.groups().values()]
        self.count = n_env * len(self._names)

    @staticmethod
    def row_bytes(scene: Scene, n_env: int) -> int:
        """Of a state on the device."""
        return 4 * _WIDTH * n_env * len(scene.moving())

    def rows(self, rows: int) -> Any:
        """Room for some states on the device: [row, body, number]."""
        import warp as wp

        return wp.empty((rows, self.count, _WIDTH), dtype=wp.float32, device=self._device)

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
        paths = [f"{env_path(env)}/{name}" for env in range(self._n_env) for name in self._names]
        return np.array(self._session.rows(groups.values(), paths), dtype=np.int32)

    def split(self, stored: NDArray[np.float32]) -> States:
        """Stored states [step, body, number] as copies, the arrays of `fields`."""
        shaped = stored.reshape(len(stored), self._n_env, -1, _WIDTH)
        return tuple(shaped[:, :, group][..., part] for group in self._groups for part in _PARTS)


def fields(scene: Scene) -> tuple[StateField, ...]:
    """Layout of the state."""
    notes = {"orientation": "reordered by the recorder from PhysX's xyzw"}
    return body_fields(scene.groups(), "float32", notes)


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
