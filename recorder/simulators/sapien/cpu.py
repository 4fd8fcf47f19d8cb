"""Environments on the CPU: a PhysxCpuSystem each, stepped one after the other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.evidence import AWAKE_BODIES, CONTACTS, Evidence
from gpusimbench.recorder.simulators.sapien.worlds import fields_of
from gpusimbench.recorder.simulators.snapshot import Envs, rows_of
from gpusimbench.schemas.provenance import Buffer, Counter, OverflowBit

# of a body in PhysxCpuSystem.pack(): quaternion wxyz, position, velocities, 13 float32 in all
_COLUMNS = {
    "position": slice(4, 7),
    "orientation": slice(0, 4),
    "linear_velocity": slice(7, 10),
    "angular_velocity": slice(10, 13),
}
_BODY = 13


class CpuWorlds:
    """See Worlds.

    PhysxCpuSystem.pack writes poses, velocities, joint angles and drive targets of a whole system at once, and the same
    bits that its components would give one by one.
    """

    device = "cpu"
    env_origins: tuple[tuple[float, float, float], ...] = ()
    buffers: tuple[Buffer, ...] = ()
    overflow_bits: tuple[OverflowBit, ...] = ()

    def __init__(
        self,
        scene: Scene,
        systems: list[Any],
        bodies: list[list[Any]],
        arms: list[Any],
        *,
        steps: list[Callable[[], Any]],
        timing_covers: str,
    ) -> None:
        """Take environments that are ready to step.

        systems        the PhysxCpuSystem of each
        bodies         of each the components that move, in the order of Scene.moving
        arms           of each the PhysxArticulation; empty where the scene has no robot
        steps          of each what makes a step
        timing_covers  what that does, in words
        """
        self.timing_covers = timing_covers
        self.fields = fields_of(scene)
        self.counters: tuple[Counter, ...] = (CONTACTS, AWAKE_BODIES) if scene.bodies else (CONTACTS,)
        self._systems = systems
        self._steps = steps
        self._bodies = bodies
        self._joints = [_in_order(arm, scene) for arm in arms]
        names = [body.name for body in scene.moving()]
        places = np.array([_places(system, moving) for system, moving in zip(systems, bodies, strict=True)])
        self._groups = [places[:, [names.index(name) for name in group]] for group in scene.groups().values()]
        self._dof = len(self._joints[0]) if arms else 0
        self._actions: NDArray[np.float32] | None = None
        self._next_action = 0
        self._counted: list[NDArray[np.int64]] | None = None  # of the last `record`; None: to be counted when asked
        self._first = self._packed().copy()

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Worlds.prepare."""
        self._actions = actions
        self._next_action = 0

    def advance(self, n_step: int) -> None:
        """See Worlds.advance."""
        self._counted = None
        if self._actions is None:
            for step in self._steps:
                for _ in range(n_step):
                    step()
            return
        targets = self._actions[self._next_action : self._next_action + n_step].tolist()
        self._next_action += n_step
        for env, (step, joints) in enumerate(zip(self._steps, self._joints, strict=True)):
            for row in targets:
                for joint, target in zip(joints, row[env], strict=True):
                    joint.set_drive_target(target)
                step()

    def state(self) -> States:
        """See Worlds.state."""
        return tuple(array[0] for array in self._split(self._packed()[None]))

    def record(self, n_step: int) -> States:
        """See Worlds.record."""
        rows, counted = [], []
        for _ in range(n_step):
            self.advance(1)
            rows.append(self._packed())
            counted.append(self._count())
        self._counted = counted
        return self._split(np.stack(rows))

    def _packed(self) -> NDArray[np.float32]:
        """The present state of every system, [env, number]."""
        return np.stack([np.frombuffer(system.pack(), dtype=np.float32) for system in self._systems])

    def _split(self, packed: NDArray[np.float32]) -> States:
        """Rows [step, env, number] as copies, the arrays of the fields."""
        n_step, n_env, _ = packed.shape
        arrays: list[NDArray[np.float32]] = []
        if self._groups:
            bodies = packed[:, :, : len(self._bodies[0]) * _BODY].reshape(n_step, n_env, -1, _BODY)
            envs = np.arange(n_env)[:, None]
            for group in self._groups:
                chosen = bodies[:, envs, group]
                arrays += [chosen[..., columns] for columns in _COLUMNS.values()]
        if self._dof:
            first = len(self._bodies[0]) * _BODY + _BODY  # behind the pose and velocities of the arm's base
            for start in (first, first + self._dof):
                arrays.append(packed[:, :, start : start + self._dof, None].copy())
        return tuple(arrays)

    def kept(self) -> dict[str, NDArray[Any]]:
        """All that PhysxCpuSystem.pack shows, copies [env, number]."""
        return {"packed": self._packed().copy()}

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
        """Write such rows, [env of envs, number], by PhysxCpuSystem.unpack."""
        for system, row in zip(self._chosen(self._systems, envs), arrays["packed"], strict=True):
            system.unpack(np.ascontiguousarray(row).tobytes())
        self._counted = None

    def place(self, states: States, envs: Envs) -> None:
        """See Simulator.set_state."""
        packed = self._first[rows_of(envs)].copy()
        n_env, first = len(packed), len(self._bodies[0]) * _BODY
        left = iter(states)
        bodies = packed[:, :first].reshape(n_env, -1, _BODY)
        every = np.arange(n_env)[:, None]
        for group in self._groups:
            for columns in _COLUMNS.values():
                bodies[every, group[rows_of(envs)], columns] = next(left)
        packed[:, :first] = bodies.reshape(n_env, -1)
        for quantity in range(2 if self._dof else 0):
            start = first + _BODY + quantity * self._dof
            packed[:, start : start + self._dof] = next(left)[..., 0]
        self.put({"packed": packed}, envs)

    def begin(self, envs: Envs) -> None:
        """See Simulator.reset."""
        self.put({"packed": self._first[rows_of(envs)]}, envs)

    def _chosen(self, items: list[Any], envs: Envs) -> list[Any]:
        return items if envs is None else [items[env] for env in envs]

    def evidence(self) -> Evidence:
        """See Worlds.evidence."""
        counts = np.stack([self._count()] if self._counted is None else self._counted)
        return Evidence({counter.name: counts[:, place] for place, counter in enumerate(self.counters)})

    def _count(self) -> NDArray[np.int64]:
        """Of the last step: [counter, env]."""
        counts = [[sum(len(pair.points) for pair in system.get_contacts()) for system in self._systems]]
        if AWAKE_BODIES in self.counters:
            counts.append([sum(not body.is_sleeping for body in moving) for moving in self._bodies])
        return np.array(counts, dtype=np.int64)

    def applied(self) -> NDArray[np.float32]:
        """See Worlds.applied."""
        held = [[joint.drive_target[0] for joint in joints] for joints in self._joints]
        return np.array(held, dtype=np.float32)


def _places(system: Any, moving: list[Any]) -> list[int]:
    """Where components are in what their system packs."""
    order = system.rigid_dynamic_components
    return [order.index(component) for component in moving]


def _in_order(arm: Any, scene: Scene) -> list[Any]:
    """The joints of an articulation, which are in the order of the scene's robot."""
    assert scene.robot is not None
    joints = list(arm.active_joints)
    names = [joint.name for joint in scene.robot.joints()]
    if [joint.name for joint in joints] != names:
        raise RuntimeError(f"SAPIEN has the joints in the order {[joint.name for joint in joints]}, not {names}")
    return joints
