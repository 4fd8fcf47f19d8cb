"""MuJoCo C on the CPU: the embedded default and the float64 reference.

Environments are the simulations of one ``mujoco.batch.Batch``, stepped on a pool of threads; MuJoCo promises results
that are bit-identical to a loop over one MjData each, at any number of threads.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from recorder.scenes.emit.mjcf import deviations, emit_mjcf
from recorder.simulators.base import Description, Simulator, States
from schemas.errors import UsageError
from schemas.fields import BODY_FIELDS, StateField, body_field, joint_field

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

_CONDIMS = (1, 3, 4, 6)


@dataclass(frozen=True)
class MujocoOptions:
    """Options of MuJoCo, named as in MJCF.

    threads    0: as many as the process may use
    solref     of contacts, two numbers: time constant [s] and damping ratio, or, both negative, stiffness and damping
    solimp     of contacts, five numbers: impedance at no penetration and at `width`, both above 0 and below 1; width
               [m]; midpoint, above 0 and below 1; power, at least 1
    tolerance  0: the solver makes all its iterations

    ValueError for a value that MuJoCo would replace by another.
    """

    integrator: str = "implicitfast"
    cone: str = "elliptic"
    solver: str = "Newton"
    iterations: int = 100
    ls_iterations: int = 50
    tolerance: float = 1e-8
    impratio: float = 1.0
    solref: str = "0.02 1"
    solimp: str = "0.9 0.95 0.001 0.5 2"
    condim: int = 3
    threads: int = 0

    def __post_init__(self) -> None:
        for name, allowed in _CHOICES.items():
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} is one of {', '.join(allowed)}, not '{getattr(self, name)}'")
        for name in ("iterations", "ls_iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is at least 1, not {getattr(self, name)}")
        if not 0 <= self.tolerance < math.inf:
            raise ValueError(f"tolerance is a number from 0 on, not {self.tolerance}")
        if not 0 < self.impratio < math.inf:
            raise ValueError(f"impratio is a number above 0, not {self.impratio}")
        if self.condim not in _CONDIMS:
            raise ValueError(f"condim is one of {', '.join(map(str, _CONDIMS))}, not {self.condim}")
        solref = self._numbers("solref", 2)
        if not (min(solref) > 0 or max(solref) < 0):
            raise ValueError(f"solref is two numbers above 0, or two below 0, not '{self.solref}'")
        least, most, width, midpoint, power = self._numbers("solimp", 5)
        low, high = mujoco.mjMINIMP, mujoco.mjMAXIMP
        if not all(low <= value <= high for value in (least, most, midpoint)):
            raise ValueError(f"solimp's first, second and fourth number are from {low} to {high}, not '{self.solimp}'")
        if width < 0 or power < 1:
            raise ValueError(f"solimp's width is at least 0 and its power at least 1, not '{self.solimp}'")
        if self.threads < 0:
            raise ValueError("threads is 0 (all that the process may use) or a positive number")

    def _numbers(self, name: str, count: int) -> list[float]:
        text = getattr(self, name)
        try:
            values = [float(word) for word in text.split()]
        except ValueError:
            raise ValueError(f"{name} is a list of numbers, not '{text}'") from None
        if len(values) != count or not all(map(math.isfinite, values)):
            raise ValueError(f"{name} is {count} finite numbers, not '{text}'")
        return values


_OPTION_ATTRIBUTES = ("integrator", "cone", "solver", "iterations", "ls_iterations", "tolerance", "impratio")
_GEOM_ATTRIBUTES = ("solref", "solimp", "condim")


class MujocoC(Simulator):
    """N environments on MuJoCo C."""

    Options = MujocoOptions

    def build(self) -> Description:
        """See Simulator.build."""
        options: MujocoOptions = self.options
        xml = emit_mjcf(
            self.scene,
            dt=self.dt,
            option={name: str(getattr(options, name)) for name in _OPTION_ATTRIBUTES},
            geom={name: str(getattr(options, name)) for name in _GEOM_ATTRIBUTES},
        )
        model = mujoco.MjModel.from_xml_string(xml)
        threads = options.threads or len(os.sched_getaffinity(0))
        self._batch = Batch(model, nsim=self.n_env, nthread=threads)
        self._batch.reset()
        self._qpos = self._batch.bind("qpos")
        self._qvel = self._batch.bind("qvel")
        self._set_initial_state(model)
        self._warned = np.zeros((self.n_env, int(mujoco.mjtWarning.mjNWARNING)), dtype=np.int64)
        return Description(
            version=mujoco.__version__,
            device="cpu",
            options={**_in_force(model, options), "threads": threads},
            switches={"precision": "float64"},
            deviations=deviations(self.scene),
            fields=self._fields(),
            timing_covers="Batch.step of all environments on all threads; no state is copied, nothing is drawn",
            attachments={"scene.xml": ("application/xml", xml.encode())},
        )

    def _fields(self) -> tuple[StateField, ...]:
        note = "rotated by the recorder from the body's frame, in which MuJoCo holds it"
        bodies = [
            body_field(group, field, "float64", names, note=note if field == "angular_velocity" else "")
            for group, names in self.scene.groups().items()
            for field in BODY_FIELDS
        ]
        if self.scene.robot is None:
            return tuple(bodies)
        joints = tuple(joint.name for joint in self.scene.robot.joints())
        return (
            *bodies,
            joint_field("robot", "qpos", "float64", joints),
            joint_field("robot", "qvel", "float64", joints),
        )

    def _set_initial_state(self, model: mujoco.MjModel) -> None:
        # for each group of bodies, where the numbers of its free joints are: [body, 7] and [body, 6]
        self._groups = []
        for names in self.scene.groups().values():
            qpos = np.array([model.joint(name).qposadr[0] for name in names])[:, None] + np.arange(_QPOS)
            qvel = np.array([model.joint(name).dofadr[0] for name in names])[:, None] + np.arange(_QVEL)
            self._groups.append((qpos, qvel))
        for body in self.scene.moving():
            start = model.joint(body.name).dofadr[0]
            self._qvel[:, start : start + 3] = body.linear_velocity
            self._qvel[:, start + 3 : start + _QVEL] = rotate_to_body(
                np.array(body.orientation), np.array(body.angular_velocity)
            )
        self._joints: NDArray[np.int64] | None = None
        if self.scene.robot is not None:
            joints = [model.joint(joint.name) for joint in self.scene.robot.joints()]
            self._joints = np.array([[j.qposadr[0], j.dofadr[0]] for j in joints])
            self._qpos[:, self._joints[:, 0]] = self.scene.robot.start
        self._actions: NDArray[np.float64] | None = None
        self._next_action = 0
        if self.scene.actions is not None:
            self._ctrl = self._batch.bind("ctrl")

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare; MuJoCo takes controls in double precision, which holds every float32."""
        self._actions = None if actions is None else actions.astype(np.float64)
        self._next_action = 0

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        if self._actions is None:
            self._batch.step(nstep=n_step)
            return
        for _ in range(n_step):
            self._ctrl[:] = self._actions[self._next_action]
            self._next_action += 1
            self._batch.step()

    def state(self) -> States:
        """See Simulator.state."""
        return self._split(self._qpos, self._qvel)

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        # Not Batch.rollout: it stops a simulation whose warning counters rise and repeats its last state.
        qpos = np.empty((n_step, *self._qpos.shape))
        qvel = np.empty((n_step, *self._qvel.shape))
        for k in range(n_step):
            self.step(1)
            qpos[k] = self._qpos
            qvel[k] = self._qvel
        return self._split(qpos, qvel)

    def _split(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> States:
        arrays: list[NDArray[np.float64]] = []
        for at_qpos, at_qvel in self._groups:
            pose, velocity = qpos[..., at_qpos], qvel[..., at_qvel]
            arrays += [
                pose[..., :3],
                pose[..., 3:],
                velocity[..., :3],
                rotate_to_world(pose[..., 3:], velocity[..., 3:]),
            ]
        if self._joints is not None:
            arrays += [qpos[..., self._joints[:, 0], None], qvel[..., self._joints[:, 1], None]]
        return tuple(arrays)

    def gates(self) -> list[str]:
        """See Simulator.gates; every MuJoCo warning is a gate."""
        counts = np.asarray(self._batch.warning)[:, :, 1].astype(np.int64)
        risen = counts - self._warned
        self._warned = counts
        fired = []
        for kind in range(counts.shape[1]):
            envs = np.flatnonzero(risen[:, kind])
            if envs.size:
                name = mujoco.mjtWarning(kind).name
                fired.append(f"MuJoCo warning {name}: {int(risen[:, kind].sum())} times, first in env {envs[0]}")
        return fired


def _in_force(model: mujoco.MjModel, asked: MujocoOptions) -> dict[str, Any]:
    """The options that the compiled model has; UsageError where one is not the one that was asked for."""
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
            raise UsageError(f"option '{name}' of simulator 'mujoco': asked for {wanted}, MuJoCo has {value}")
    return found


def _text(values: Iterable[float]) -> str:
    return " ".join(np.format_float_positional(value, trim="-") for value in values)


def rotate_to_world(quaternion: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotate vectors [..., 3] by unit quaternions wxyz [..., 4]: v + 2 s (u x v) + 2 u x (u x v)."""
    scalar, axis = quaternion[..., :1], quaternion[..., 1:]
    twice = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + scalar * twice + np.cross(axis, twice))


def rotate_to_body(quaternion: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotate vectors [..., 3] by the inverse of unit quaternions wxyz [..., 4]."""
    inverse = quaternion * np.array([1.0, -1.0, -1.0, -1.0])
    return rotate_to_world(inverse, vector)
