"""Environments on a GPU: scenes at a distance from each other in one PhysxGpuSystem.

Written against the interface that SAPIEN documents. With the PhysX that SAPIEN is released with it has not been run,
for want of that library for GPUs.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene, Vector
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.sapien.complaints import OVERFLOW_BITS, Complaints
from gpusimbench.recorder.simulators.sapien.worlds import fields_of
from gpusimbench.schemas.fields import StateField
from gpusimbench.schemas.provenance import Buffer, Counter

# of a body in PhysxGpuSystem.cuda_rigid_body_data: position, quaternion wxyz, velocities, 13 float32 in all
_COLUMNS = {
    "position": slice(0, 3),
    "orientation": slice(3, 7),
    "linear_velocity": slice(7, 10),
    "angular_velocity": slice(10, 13),
}
_BODY = 13
_RING_ROWS = 50
_RING_BYTES = 512 << 20


class GpuWorlds:
    """See Worlds. Overflow bits are those of all environments, which share one system."""

    counters: tuple[Counter, ...] = ()
    overflow_bits = OVERFLOW_BITS

    def __init__(
        self,
        scene: Scene,
        system: Any,
        bodies: list[list[Any]],
        *,
        origins: tuple[Vector, ...],
        buffers: tuple[Buffer, ...],
        complaints: Complaints,
        step: Callable[[], Any],
        timing_covers: str,
    ) -> None:
        """Take environments of a system whose gpu_init was called.

        bodies         of each the components that move, in the order of Scene.moving
        step           makes a step; may return before the GPU is done
        timing_covers  what it does, in words
        """
        import torch

        self.device = str(torch.cuda.get_device_name())
        self.env_origins = origins
        self.buffers = buffers
        self.fields = tuple(map(_relative, fields_of(scene)))
        self.timing_covers = f"{timing_covers}; one synchronisation for each clock reading"
        self._system = system
        self._complaints = complaints
        self._step = step
        self._scene = scene
        self._n_env = len(bodies)
        self._bodies = system.cuda_rigid_body_data.torch()  # [place, 13], the engine's own memory
        places = [[component.gpu_pose_index for component in moving] for moving in bodies]
        self._places = torch.tensor(places, dtype=torch.int64, device=self._bodies.device)  # [env, body]
        rows = max(1, min(_RING_ROWS, _RING_BYTES // (4 * _BODY * self._places.numel())))
        self._ring = torch.empty((rows, *self._places.shape, _BODY), dtype=torch.float32, device=self._bodies.device)
        names = [body.name for body in scene.moving()]
        self._groups = [[names.index(name) for name in group] for group in scene.groups().values()]
        self._masks: list[int] | None = None  # of the last `record`; None: to be asked for

    def begin(self) -> None:
        """Put all bodies where the scene has them: gpu_init has made a step to warm up."""
        import torch

        moving = self._scene.moving()
        start = [(*b.position, *b.orientation, *b.linear_velocity, *b.angular_velocity) for b in moving]
        self._bodies[self._places] = torch.tensor(start, dtype=torch.float32, device=self._bodies.device)
        self._system.gpu_apply_rigid_dynamic_data()
        self._system.gpu_fetch_rigid_dynamic_data()
        torch.cuda.synchronize()

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Worlds.prepare; there are none."""

    def advance(self, n_step: int) -> None:
        """See Worlds.advance."""
        import torch

        self._masks = None
        for _ in range(n_step):
            self._step()
        torch.cuda.synchronize()

    def state(self) -> States:
        """See Worlds.state."""
        self._system.gpu_fetch_rigid_dynamic_data()
        return tuple(array[0] for array in self._split(self._bodies[self._places].cpu().numpy()[None]))

    def record(self, n_step: int) -> States:
        """See Worlds.record."""
        import torch

        parts, masks = [], []
        for first in range(0, n_step, len(self._ring)):
            rows = min(len(self._ring), n_step - first)
            for row in range(rows):
                self._step()
                self._system.gpu_fetch_rigid_dynamic_data()
                torch.index_select(self._bodies, 0, self._places.view(-1), out=self._ring[row].view(-1, _BODY))
                masks.append(self._complaints.take_bits())  # PhysX has complained by the time that its step is over
            parts.append(self._split(self._ring[:rows].cpu().numpy()))
        self._masks = masks
        return parts[0] if len(parts) == 1 else tuple(map(np.concatenate, zip(*parts, strict=True)))

    def _split(self, rows: NDArray[np.float32]) -> States:
        """Rows [step, env, body, 13] as copies, the arrays of the fields."""
        return tuple(
            np.ascontiguousarray(rows[:, :, group][..., columns])
            for group in self._groups
            for columns in _COLUMNS.values()
        )

    def evidence(self) -> Evidence:
        """See Worlds.evidence."""
        masks = [self._complaints.take_bits()] if self._masks is None else self._masks
        return Evidence(overflow=np.repeat(np.array(masks, dtype=np.uint32)[:, None], self._n_env, axis=1))

    def applied(self) -> NDArray[np.float32]:
        """See Worlds.applied."""
        raise NotImplementedError("there are no robots on a GPU")


def square_grid(n_env: int, spacing: float) -> tuple[Vector, ...]:
    """Origins on a square grid, of which one is at zero, as ManiSkill lays them out [m]."""
    side = math.ceil(math.sqrt(n_env))
    return tuple((spacing * (env % side - side // 2), spacing * (env // side - side // 2), 0.0) for env in range(n_env))


def _relative(field: StateField) -> StateField:
    if field.field != "position":
        return field
    return replace(field, frame="env", note="SAPIEN subtracts the environment's origin on the device, in float32")
