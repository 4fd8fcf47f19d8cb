"""The states and controls of a model file in PhysX, in MuJoCo's order, read and written where the engine computes.

Positions and velocities of a recording are [env, nq] and [env, nv] at MuJoCo's places, in PhysX's own terms: joints
from the reference state on, quaternions xyzw, velocities of the centre of mass in the world's frame.

As for robots (recorder.simulators.physx.arms), tensors cannot be used before a first step, so that a step of a
nanosecond is made here, and the first state is written afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Vector
from gpusimbench.recorder.scenes.emit.usd import env_path
from gpusimbench.recorder.scenes.model import BODIES, ModelScene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.mujoco.layout import StateGroup
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel
from gpusimbench.recorder.simulators.newton.layout import ModelLayout, NewtonFreeBodies, NewtonJoints
from gpusimbench.recorder.simulators.physx import libraries
from gpusimbench.recorder.simulators.physx.plan import Plan, Tree
from gpusimbench.recorder.simulators.physx.servos import TARGETS, Driven
from gpusimbench.recorder.simulators.physx.session import Session, every
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.fields import StateField

_POSITIONS, _VELOCITIES = "positions", "velocities"
_DOFS = ("DOF_POSITION", "DOF_VELOCITY")
_ROOT = ("ROOT_POSE", "ROOT_VELOCITY")


@dataclass(frozen=True)
class _Column:
    """A tensor of an articulation, and where its numbers are.

    binding     ovphysx's
    array       [articulation, number] on the device
    velocities  whether it has velocities, or positions
    at          places among those of an environment, [number]
    rows        by environment, its row
    first       place in a stored state
    """

    binding: Any
    array: Any
    velocities: bool
    at: NDArray[np.int64]
    rows: NDArray[np.int64]
    first: int

    def size(self) -> int:
        """Numbers in a stored state."""
        return int(np.prod(self.array.shape))


class Articulations:
    """The articulations of all environments."""

    def __init__(
        self, session: Session, plan: Plan, compiled: MjcfModel, driven: Driven, *, n_env: int,
        origins: Sequence[Vector], device: Any,
    ) -> None:  # fmt: skip
        """device  warp.Device of the engine's arrays"""
        self._session, self._device, self._n_env = session, device, n_env
        self._plan, self._compiled, self._driven = plan, compiled, driven
        self._origins = np.array(origins or [(0.0, 0.0, 0.0)] * n_env, dtype=np.float32)
        self.layout = layout_of(compiled)
        self._roots = [self._of_root(tree) for tree in plan.trees]
        self._rows: list[NDArray[np.int64]] = []
        self._columns: list[_Column] = []
        self._targets: list[tuple[dict[str, Any], list[int], NDArray[np.int64]]] = []
        for tree in plan.trees:
            self._bind(tree)
        self._total = sum(column.size() for column in self._columns)
        self._given: list[list[tuple[Any, Any]]] = []  # for each step to come, last first: tensors and their values
        session.physx.warmup()
        self.put(self.first(), None, stepped=False)

    def _of_root(self, tree: Tree) -> list[str]:
        end = f"/{tree.links[0].prim}" if tree.free >= 0 else ""
        return [f"{env_path(env)}/{tree.prim}{end}" for env in range(self._n_env)]

    def _tensor(self, tree: Tree, name: str) -> Any:
        from ovphysx.types import TensorType

        kind = TensorType[f"ARTICULATION_{name}"]
        paths = self._roots[self._plan.trees.index(tree)]
        with libraries.quiet():
            return self._session.physx.create_tensor_binding(prim_paths=paths, tensor_type=kind)

    def held(self, tree: Tree, name: str) -> tuple[tuple[str, ...], tuple[str, ...], NDArray[np.float32]]:
        """What PhysX holds of a tree in environment 0, by the name of a tensor: names of its links, names of its
        joints, and the rows."""
        binding = self._tensor(tree, name)
        try:
            rows = np.empty(binding.shape, dtype=np.float32)
            with libraries.quiet():
                binding.read(rows)
            index = list(binding.prim_paths).index(self._roots[self._plan.trees.index(tree)][0])
            return tuple(binding.body_names), tuple(binding.dof_names), rows[index]
        finally:
            binding.destroy()

    def link_poses(self) -> NDArray[np.float32]:
        """Poses of MuJoCo's bodies, positions and quaternions wxyz, [env, body, 7]; those that never move are where
        MuJoCo has them, beside each environment's origin."""
        import warp as wp

        found = reference_poses(self._compiled, self._origins)
        for tree, roots in zip(self._plan.trees, self._roots, strict=True):
            binding = self._tensor(tree, "LINK_POSE")
            array = wp.empty(binding.shape, dtype=wp.float32, device=self._device)
            binding.read(array)
            rows = [list(binding.prim_paths).index(path) for path in roots]
            links = {link.prim: link.body for link in tree.links if link.body >= 0}
            for number, name in enumerate(binding.body_names):
                if name in links:
                    found[:, links[name]] = array.numpy()[rows, number][:, [0, 1, 2, 6, 3, 4, 5]]
            binding.destroy()
        return found

    def hold(self, controls: NDArray[np.float64]) -> None:
        """Hold these controls, [env, actuator], until others are given."""
        self._given = [[]]
        self._take(controls[None])
        for tensor, values in self._given.pop():
            tensor.write(values)

    def _bind(self, tree: Tree) -> None:
        model, own = self._compiled.model, self._plan.joint_prims
        number = {own[joint]: joint for joint in tree.joints()}
        wanted = self._roots[self._plan.trees.index(tree)]
        rows: NDArray[np.int64] | None = None
        joints: list[int] = []
        for velocities, name in enumerate((*_ROOT, *_DOFS)):
            if (name in _ROOT and tree.free < 0) or (name in _DOFS and not number):
                continue
            binding = self._tensor(tree, name)
            found = list(binding.prim_paths)
            if sorted(found) != sorted(wanted):
                raise GsbError(f"PhysX has {len(found)} articulations {tree.prim}, not {len(wanted)}")
            index = {path: row for row, path in enumerate(found)}
            rows = np.array([index[path] for path in wanted])
            second = bool(velocities % 2)
            if name in _ROOT:
                address = int((model.jnt_dofadr if second else model.jnt_qposadr)[tree.free])
                at = address + np.arange(6 if second else 7)
            else:
                joints = [number.get(joint, -1) for joint in binding.dof_names]
                if sorted(joints) != sorted(number.values()):
                    raise GsbError(f"PhysX has the joints {', '.join(binding.dof_names)} in {tree.prim}")
                at = np.asarray(model.jnt_dofadr if second else model.jnt_qposadr)[joints].astype(np.int64)
            self._add(binding, second, at, rows)
        if joints and rows is not None:
            self._targets.append(({name: self._tensor(tree, f"DOF_{name}") for name in TARGETS}, joints, rows))

    def _add(self, binding: Any, velocities: bool, at: NDArray[np.int64], rows: NDArray[np.int64]) -> None:
        import warp as wp

        first = sum(column.size() for column in self._columns)
        array = wp.empty(binding.shape, dtype=wp.float32, device=self._device)
        self._columns.append(_Column(binding, array, velocities, at, rows, first))

    def first(self) -> dict[str, NDArray[Any]]:
        """The first state, as `kept` returns it."""
        positions, velocities = first_state(self._plan, self.layout, self._origins)
        return {_POSITIONS: positions, _VELOCITIES: velocities}

    def kept(self) -> dict[str, NDArray[Any]]:
        """Positions and velocities: copies [env, number]."""
        import warp as wp

        stored = wp.empty((1, *self.row_shape), dtype=wp.float32, device=self._device)
        self.store(stored, 0)
        positions, velocities = self._sorted(stored.numpy(), slice(None))
        return {_POSITIONS: positions[0], _VELOCITIES: velocities[0]}

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs, *, stepped: bool) -> None:
        """Write such rows, [env of envs, number]; it does not matter here whether the bodies have stepped."""
        for column in self._columns:
            rows = column.rows if envs is None else column.rows[envs]
            whole = np.zeros(column.binding.shape, dtype=np.float32)
            whole[rows] = arrays[_VELOCITIES if column.velocities else _POSITIONS][:, column.at]
            column.binding.write(whole, indices=rows.astype(np.int32))
        paths = [roots[env] for roots in self._roots for env in every(self._n_env, envs)]
        self._session.physx.update_articulations_kinematic(prim_paths=self._session.handles(paths))

    def merged(self, states: States, first: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """What `put` takes, of the fields' arrays [env, item, width]; they replace all of `first`."""
        positions, velocities = self.layout.joined(states)
        return {_POSITIONS: positions.astype(np.float32), _VELOCITIES: velocities.astype(np.float32)}

    @property
    def row_shape(self) -> tuple[int, ...]:
        """Of a stored state: [number], the columns one after the other."""
        return (self._total,)

    def begin(self) -> None:
        """The tensors are there."""

    def store_step(self, stored: Any, row: int) -> None:
        """Store the state that a step has left."""
        self.store(stored, row)

    def store(self, stored: Any, row: int) -> bool:
        """Store the present state."""
        import warp as wp

        for column in self._columns:
            column.binding.read(column.array)
            wp.copy(stored, column.array.flatten(), dest_offset=row * self._total + column.first, count=column.size())
        return True

    def _sorted(self, stored: NDArray[np.float32], envs: slice) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        # stored states of a range of environments as positions and velocities, [row, env, number]
        model, count = self._compiled.model, len(range(self._n_env)[envs])
        positions, velocities = (np.zeros((len(stored), count, n), dtype=np.float32) for n in (model.nq, model.nv))
        for column in self._columns:
            flat = stored[:, column.first : column.first + column.size()]
            values = flat.reshape(len(stored), *column.array.shape)[:, column.rows[envs]]
            (velocities if column.velocities else positions)[..., column.at] = values
        return positions, velocities

    def fields(self) -> tuple[StateField, ...]:
        """Layout of the state."""
        return self.layout.fields()

    def split(self, stored: NDArray[np.float32], envs: slice = slice(None)) -> States:
        """Of a range of environments, the arrays of `fields` in stored states, as copies."""
        return self.layout.split(*self._sorted(stored, envs))

    def prepare(self, controls: NDArray[np.float32]) -> None:
        """Take the controls of the next steps, [step, env, actuator]."""
        self._given = [[] for _ in controls]
        self._take(controls)
        self._given.reverse()

    def _take(self, controls: NDArray[np.floating]) -> None:
        import warp as wp

        for tensors, joints, rows in self._targets:
            for name, values in self._driven.of(self._compiled.model, joints, controls).items():
                if name not in self._driven.uses:
                    continue
                whole = np.zeros((len(controls), self._n_env, len(joints)), dtype=np.float32)
                whole[:, rows] = values
                moved = wp.array(whole, dtype=wp.float32, device=self._device)
                for step, given in enumerate(self._given):
                    given.append((tensors[name], moved[step]))

    def command(self) -> None:
        """Give the drives what they do in the next step."""
        if self._given:
            for tensor, values in self._given.pop():
                tensor.write(values)

    def applied(self) -> None:
        """PhysX holds targets and forces, and not the controls that they were made of."""
        return

    def close(self) -> None:
        """Give the engine's tensors back."""
        for column in self._columns:
            column.binding.destroy()
        for tensors, _, _ in self._targets:
            for tensor in tensors.values():
                tensor.destroy()
        self._columns.clear()
        self._targets.clear()


def layout_of(compiled: MjcfModel) -> ModelLayout:
    """Where the fields of a recording are, at MuJoCo's places, in PhysX's terms."""
    model, scene = compiled.model, compiled.scene
    assert isinstance(scene, ModelScene)
    parts: list[StateGroup] = []
    for part in compiled.layout:
        if part.group == BODIES:
            bodies = [scene_body(model, name) for name in part.names]
            centres = np.array(model.body_ipos[bodies], dtype=np.float32)
            parts.append(
                NewtonFreeBodies(part.group, part.names, part.at_qpos, part.at_qvel, centres=centres, engine="PhysX")
            )
        else:
            slides = frozenset(joint.name for joint in scene.joints if joint.slides)
            reference = model.qpos0[part.at_qpos].astype(np.float32)
            parts.append(
                NewtonJoints(part.group, part.names, part.at_qpos, part.at_qvel, slides=slides, reference=reference)
            )
    blank = ModelLayout(tuple(parts), np.zeros(model.nq), np.zeros(model.nv))
    positions, velocities = blank.joined(compiled.split(compiled.qpos0[None], compiled.qvel0[None]))
    return ModelLayout(tuple(parts), positions[0], velocities[0])


def first_state(
    plan: Plan, layout: ModelLayout, origins: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Positions [env, nq] and velocities [env, nv] in the model's first state, as of `layout_of`, where environments
    are beside each other; origins are theirs, [env, 3]."""
    positions, velocities = (
        np.tile(numbers, (len(origins), 1)).astype(np.float32) for numbers in (layout.joint_q, layout.joint_qd)
    )
    for tree in plan.trees:
        if tree.free >= 0:
            at = int(plan.model.jnt_qposadr[tree.free])
            positions[:, at : at + 3] += origins
    return positions, velocities


def reference_poses(compiled: MjcfModel, origins: NDArray[np.float32]) -> NDArray[np.float32]:
    """Poses of MuJoCo's bodies in the reference state, positions and quaternions wxyz, [env, body, 7], beside each
    environment's origin, [env, 3]."""
    data = compiled.data()
    found = np.tile(np.concatenate([data.xpos, data.xquat], axis=1).astype(np.float32), (len(origins), 1, 1))
    found[..., :3] += origins[:, None]
    return found


def scene_body(model: Any, name: str) -> int:
    """The number of a body on a free joint that a recording calls so."""
    free = [j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE]
    bodies = [int(model.jnt_bodyid[j]) for j in free]
    return next(b for b in bodies if (model.body(b).name or f"body{b}") == name)
