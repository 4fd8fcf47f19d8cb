"""Joint angles and speeds of the robots, in the scene's order, gathered where the engine computes.

The engine's tensors have all joints at once, in radians; its read-outs, by which bodies are recorded, come joint by
joint, in degrees. Tensors cannot be used before a first step: it is made here, of a nanosecond, and the first state is
written afterwards.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Robot, Scene
from gpusimbench.recorder.scenes.emit.usd import env_path, prim_names
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.physx import libraries
from gpusimbench.recorder.simulators.physx.session import Session
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.fields import StateField, joint_field

_WIDTH = 2  # numbers of a joint: angle and speed


class Arms:
    """The robots of all environments."""

    def __init__(self, session: Session, scene: Scene, robot: Robot, *, n_env: int, device: Any) -> None:
        """device  warp.Device of the engine's arrays"""
        import warp as wp
        from ovphysx.types import TensorType

        self._session, self._device = session, device
        self._n_env, self._joints = n_env, [joint.name for joint in robot.joints()]
        paths = [f"{env_path(env)}/{prim_names(scene)[robot.name]}" for env in range(n_env)]
        self._bindings: dict[str, Any] = {}
        with libraries.quiet():
            for name in ("POSITION", "VELOCITY", "POSITION_TARGET"):
                kind = TensorType[f"ARTICULATION_DOF_{name}"]
                self._bindings[name] = session.physx.create_tensor_binding(prim_paths=paths, tensor_type=kind)
        self._rows = self._order(paths)
        shape = self._bindings["POSITION"].shape
        self._angles = wp.empty(shape, dtype=wp.float32, device=device)
        self._speeds = wp.empty(shape, dtype=wp.float32, device=device)
        self._targets: list[Any] = []
        self._begin(robot)

    def _order(self, paths: list[str]) -> NDArray[np.int64]:
        """For each environment, its row in the engine's tensors."""
        binding = self._bindings["POSITION"]
        found = list(binding.prim_paths)
        if sorted(found) != sorted(paths) or list(binding.dof_names) != self._joints:
            raise GsbError(f"PhysX has {len(found)} robots with the joints {', '.join(binding.dof_names)}")
        rows = {path: row for row, path in enumerate(found)}
        return np.array([rows[path] for path in paths])

    def _begin(self, robot: Robot) -> None:
        self._session.physx.warmup()
        start = np.tile(np.array(robot.start, dtype=np.float32), (self._n_env, 1))
        for name, values in (("POSITION", start), ("VELOCITY", np.zeros_like(start)), ("POSITION_TARGET", start)):
            self._bindings[name].write(values)
        self._session.physx.update_articulations_kinematic()  # links follow their joints

    @staticmethod
    def row_bytes(scene: Scene, n_env: int) -> int:
        """Of a state on the device."""
        return 4 * _WIDTH * n_env * len(scene.robot.joints() if scene.robot else ())

    def rows(self, rows: int) -> Any:
        """Room for some states on the device: [row, quantity, robot, joint], rows as the engine has them."""
        import warp as wp

        return wp.empty((rows, _WIDTH, *self._angles.shape), dtype=wp.float32, device=self._device)

    def store(self, stored: Any, row: int) -> bool:
        """Store the present state."""
        import warp as wp

        for quantity, (name, array) in enumerate((("POSITION", self._angles), ("VELOCITY", self._speeds))):
            self._bindings[name].read(array)
            wp.copy(stored[row, quantity], array)
        return True

    def split(self, stored: NDArray[np.float32]) -> States:
        """Stored states as copies, the arrays of `fields`."""
        return tuple(stored[:, quantity, self._rows, :, None] for quantity in range(_WIDTH))

    def prepare(self, targets: NDArray[np.float32]) -> None:
        """Take the targets of the next steps, [step, env, joint]."""
        import warp as wp

        rows = np.empty_like(targets)
        rows[:, self._rows] = targets
        moved = wp.array(rows, dtype=wp.float32, device=self._device)
        self._targets = [moved[step] for step in reversed(range(len(targets)))]

    def command(self) -> None:
        """Give the drives the targets of the next step."""
        self._bindings["POSITION_TARGET"].write(self._targets.pop())

    def applied(self) -> NDArray[np.float32]:
        """The targets that the drives hold, [env, joint]."""
        held = np.empty(self._angles.shape, dtype=np.float32)
        self._bindings["POSITION_TARGET"].read(held)
        return np.asarray(held[self._rows])

    def close(self) -> None:
        """Give the engine's tensors back."""
        for binding in self._bindings.values():
            binding.destroy()
        self._bindings.clear()


def fields(robot: Robot) -> tuple[StateField, ...]:
    """Layout of the state."""
    joints = tuple(joint.name for joint in robot.joints())
    return joint_field("robot", "qpos", "float32", joints), joint_field("robot", "qvel", "float32", joints)
