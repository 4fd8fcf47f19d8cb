"""Joint angles and speeds of the robots, in the scene's order, gathered where the engine computes.

The engine's tensors have all joints at once, in radians; its read-outs, by which bodies are recorded, come joint by
joint, in degrees. Tensors cannot be used before a first step: it is made here, of a nanosecond, and the first state is
written afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Robot, Scene
from gpusimbench.recorder.scenes.emit.usd import env_path, prim_names
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.physx import libraries
from gpusimbench.recorder.simulators.physx.session import Session, every
from gpusimbench.recorder.simulators.snapshot import Envs
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
        paths = self._paths = [f"{env_path(env)}/{prim_names(scene)[robot.name]}" for env in range(n_env)]
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
        self.put({"POSITION": start, "VELOCITY": np.zeros_like(start), "POSITION_TARGET": start}, None, stepped=False)

    def kept(self) -> dict[str, NDArray[Any]]:
        """Angles, speeds and the targets of the drives: copies [env, joint] by the engine's names."""
        found: dict[str, NDArray[Any]] = {}
        for name, binding in self._bindings.items():
            held = np.empty(binding.shape, dtype=np.float32)
            binding.read(held)
            found[name] = held[self._rows]
        return found

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs, *, stepped: bool) -> None:
        """Write such rows, [env of envs, joint]; it does not matter here whether the robots have stepped."""
        rows = self._rows if envs is None else self._rows[envs]
        for name, values in arrays.items():
            whole = np.zeros(self._bindings[name].shape, dtype=np.float32)
            whole[rows] = values
            self._bindings[name].write(whole, indices=rows.astype(np.int32))
        handles = self._session.handles([self._paths[env] for env in every(self._n_env, envs)])
        self._session.physx.update_articulations_kinematic(prim_paths=handles)  # links follow their joints

    def merged(self, states: States, first: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """What `put` takes, of the fields' arrays [env, joint, 1]; all else is of `first`."""
        angles, speeds = (array[..., 0] for array in states)
        return {**first, "POSITION": angles, "VELOCITY": speeds}

    @property
    def row_shape(self) -> tuple[int, ...]:
        """Of a stored state: [quantity, robot, joint], rows as the engine has them."""
        return _WIDTH, *self._angles.shape

    def begin(self) -> None:
        """The tensors are there."""

    def store_step(self, stored: Any, row: int) -> None:
        """Store the state that a step has left."""
        self.store(stored, row)

    def store(self, stored: Any, row: int) -> bool:
        """Store the present state."""
        import warp as wp

        for quantity, (name, array) in enumerate((("POSITION", self._angles), ("VELOCITY", self._speeds))):
            self._bindings[name].read(array)
            wp.copy(stored[row, quantity], array)
        return True

    def fields(self) -> tuple[StateField, ...]:
        """Layout of the state."""
        joints = tuple(self._joints)
        return joint_field("robot", "qpos", "float32", joints), joint_field("robot", "qvel", "float32", joints)

    def split(self, stored: NDArray[np.float32], envs: slice = slice(None)) -> States:
        """Of a range of environments, the arrays of `fields` in stored states, as copies."""
        return tuple(stored[:, quantity, self._rows[envs], :, None] for quantity in range(_WIDTH))

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
