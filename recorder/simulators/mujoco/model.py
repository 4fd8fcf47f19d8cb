"""A scene compiled by MuJoCo, for every engine that takes its model from there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.mjcf import emit_mjcf
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.mujoco.options import GEOM_ATTRIBUTES, OPTION_ATTRIBUTES, MjcfOptions
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.fields import StateField, body_fields, joint_field

KNOWS_AUTORESET = hasattr(mujoco.mjtDisableBit, "mjDSBL_AUTORESET")
"""Whether this release can be told not to reset a state that went bad; older ones always do, with a warning."""

_QPOS = 7  # of a free joint: position 3, orientation wxyz 4
_QVEL = 6  # of a free joint: linear velocity in the world frame 3, angular velocity in the body's frame 3

_CHOICES: dict[str, dict[str, int]] = {
    "integrator": {
        "Euler": mujoco.mjtIntegrator.mjINT_EULER,
        "RK4": mujoco.mjtIntegrator.mjINT_RK4,
        "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
        "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    },
    "cone": {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL},
    "solver": {
        "Newton": mujoco.mjtSolver.mjSOL_NEWTON,
        "CG": mujoco.mjtSolver.mjSOL_CG,
        "PGS": mujoco.mjtSolver.mjSOL_PGS,
    },
}
"""The values that MJCF has for an option, and MuJoCo's number of each."""


@dataclass(frozen=True)
class MjcfModel:
    """One environment as MuJoCo compiles it, and where its numbers are.

    scene   that it was made from
    xml     MJCF
    model   mujoco.MjModel
    qpos0   initial positions, shape [nq]
    qvel0   initial velocities, shape [nv]
    """

    scene: Scene
    xml: str
    model: Any
    qpos0: NDArray[np.float64]
    qvel0: NDArray[np.float64]
    _groups: tuple[tuple[NDArray[np.int64], NDArray[np.int64]], ...]
    _joints: NDArray[np.int64] | None

    @property
    def attachments(self) -> dict[str, tuple[str, bytes]]:
        """The model as a recording carries it."""
        return {"scene.xml": ("application/xml", self.xml.encode())}

    def fields(self, dtype: str) -> tuple[StateField, ...]:
        """Layout of the state."""
        note = "rotated by the recorder from the body's frame, in which MuJoCo holds it"
        bodies = body_fields(self.scene.groups(), dtype, {"angular_velocity": note})
        if self.scene.robot is None:
            return tuple(bodies)
        joints = tuple(joint.name for joint in self.scene.robot.joints())
        return (
            *bodies,
            joint_field("robot", "qpos", dtype, joints),
            joint_field("robot", "qvel", dtype, joints),
        )

    @property
    def coordinates(self) -> NDArray[np.int64]:
        """Places in qpos of x, y and z of the bodies in `fields`."""
        found = [at_qpos[:, :3].ravel() for at_qpos, _ in self._groups]
        return np.concatenate(found) if found else np.empty(0, dtype=np.int64)

    def split(self, qpos: NDArray[np.floating], qvel: NDArray[np.floating]) -> States:
        """qpos [..., nq] and qvel [..., nv] as the arrays of `fields`, in their own precision; views where possible."""
        arrays: list[NDArray[np.floating]] = []
        for at_qpos, at_qvel in self._groups:
            pose, velocity = _picked(qpos, at_qpos), _picked(qvel, at_qvel)
            arrays += [
                pose[..., :3],
                pose[..., 3:],
                velocity[..., :3],
                rotate_to_world(pose[..., 3:], velocity[..., 3:]),
            ]
        if self._joints is not None:
            arrays += [_picked(qpos, self._joints[:, :1]), _picked(qvel, self._joints[:, 1:])]
        return tuple(arrays)

    def joined(self, states: States) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The arrays of `fields`, [env, item, width], as qpos [env, nq] and qvel [env, nv]: the inverse of `split`, but
        for the rounding of angular velocities, which are rotated."""
        n_env = len(states[0])
        qpos, qvel = np.tile(self.qpos0, (n_env, 1)), np.tile(self.qvel0, (n_env, 1))
        left = iter(np.asarray(array, dtype=np.float64) for array in states)
        for at_qpos, at_qvel in self._groups:
            position, orientation, linear, angular = (next(left) for _ in range(4))
            qpos[:, at_qpos] = np.concatenate([position, orientation], axis=-1)
            qvel[:, at_qvel] = np.concatenate([linear, rotate_to_body(orientation, angular)], axis=-1)
        if self._joints is not None:
            qpos[:, self._joints[:, 0]], qvel[:, self._joints[:, 1]] = next(left)[..., 0], next(left)[..., 0]
        return qpos, qvel

    def data(self) -> Any:
        """A mujoco.MjData in the initial state, with everything computed from it."""
        data = mujoco.MjData(self.model)
        data.qpos[:], data.qvel[:] = self.qpos0, self.qvel0
        mujoco.mj_forward(self.model, data)
        return data

    def rollout(self, *, n_step: int, seed: int = 0, n_env: int = 1) -> Iterator[Any]:
        """The mujoco.MjData of each environment after each of n_step steps on MuJoCo C; the same object again and
        again. Environments differ in their actions alone."""
        actions = self.scene.actions
        drawn = None if actions is None else actions.draw(seed, n_env=n_env, first_step=0, n_step=n_step)
        for env in range(n_env if drawn is not None else 1):
            data = self.data()
            yield data
            for step in range(n_step):
                if drawn is not None:
                    data.ctrl[:] = drawn[step, env]
                mujoco.mj_step(self.model, data)
                yield data

    def in_force(self, asked: MjcfOptions, simulator: str) -> dict[str, Any]:
        """The options that the compiled model has; UsageError where one is not the one that was asked for."""
        model = self.model
        found: dict[str, Any] = {
            name: next(word for word, number in words.items() if number == getattr(model.opt, name))
            for name, words in _CHOICES.items()
        }
        for name in ("iterations", "ls_iterations", "tolerance", "impratio"):
            found[name] = getattr(model.opt, name)
        # every geom has the defaults
        found["solref"] = _text(model.geom_solref[0])
        found["solimp"] = _text(model.geom_solimp[0])
        found["condim"] = int(model.geom_condim[0])
        for name, value in found.items():
            wanted = getattr(asked, name)
            if name in ("solref", "solimp"):
                wanted = _text([float(word) for word in wanted.split()])
            if value != wanted:
                raise UsageError(f"option '{name}' of simulator '{simulator}': asked for {wanted}, MuJoCo has {value}")
        return found


def compile_scene(
    scene: Scene, *, dt: float, options: MjcfOptions, numerics: dict[str, str] | None = None
) -> MjcfModel:
    """Compile a scene with these options.

    numerics  custom numbers that engines read from the model, such as MJX's max_geom_pairs
    """
    xml = emit_mjcf(
        scene,
        dt=dt,
        option={name: str(getattr(options, name)) for name in OPTION_ATTRIBUTES},
        geom={name: str(getattr(options, name)) for name in GEOM_ATTRIBUTES},
        numerics=numerics,
        autoreset=KNOWS_AUTORESET,
    )
    model = mujoco.MjModel.from_xml_string(xml)
    qpos0, qvel0 = model.qpos0.copy(), np.zeros(model.nv)
    for body in scene.moving():
        start = model.joint(body.name).dofadr[0]
        qvel0[start : start + 3] = body.linear_velocity
        qvel0[start + 3 : start + _QVEL] = rotate_to_body(np.array(body.orientation), np.array(body.angular_velocity))
    # for each group of bodies, where the numbers of its free joints are: [body, 7] and [body, 6]
    groups = tuple(
        (
            np.array([model.joint(name).qposadr[0] for name in names])[:, None] + np.arange(_QPOS),
            np.array([model.joint(name).dofadr[0] for name in names])[:, None] + np.arange(_QVEL),
        )
        for names in scene.groups().values()
    )
    joints = None
    if scene.robot is not None:
        found = [model.joint(joint.name) for joint in scene.robot.joints()]
        joints = np.array([[j.qposadr[0], j.dofadr[0]] for j in found])
        qpos0[joints[:, 0]] = scene.robot.start
    return MjcfModel(scene, xml, model, qpos0, qvel0, groups, joints)


def _text(values: Iterable[float]) -> str:
    return " ".join(np.format_float_positional(value, trim="-") for value in values)


def _picked(array: NDArray[np.floating], index: NDArray[np.int64]) -> NDArray[np.floating]:
    # array[..., index]; numbers that lie side by side, as those of one kind of bodies do, are not copied
    first = int(index.flat[0])
    if np.array_equal(index.ravel(), np.arange(first, first + index.size)):
        return array[..., first : first + index.size].reshape(*array.shape[:-1], *index.shape)
    return np.asarray(array[..., index])


def rotate_to_world(quaternion: NDArray[np.floating], vector: NDArray[np.floating]) -> NDArray[np.floating]:
    """Rotate vectors [..., 3] by unit quaternions wxyz [..., 4]: v + 2 s (u x v) + 2 u x (u x v)."""
    scalar, axis = quaternion[..., :1], quaternion[..., 1:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + scalar * twice + np.cross(axis, twice))


def rotate_to_body(quaternion: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.floating]:
    """Rotate vectors [..., 3] by the inverse of unit quaternions wxyz [..., 4]."""
    inverse = quaternion * np.array([1.0, -1.0, -1.0, -1.0])
    return rotate_to_world(inverse, vector)
