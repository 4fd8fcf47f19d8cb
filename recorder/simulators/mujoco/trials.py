"""How a model is tried on an engine: drawn poses for its kinematics, single impulses and controls for its dynamics.

All engines are given the same numbers, which depend on the model's files and the seed alone. What is drawn for a joint
depends on its name and limits, and on no other joint, so that copies of a model with one difference are tried alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from zlib import crc32

import mujoco
import numpy as np
from mujoco import mjtJoint
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.model.scene import ModelScene
from gpusimbench.recorder.simulators.base import States
from gpusimbench.recorder.simulators.mujoco.imported import of_c
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import own_options

N_POSE = 16
"""Poses that are drawn."""

N_STEP = 10
"""Steps of a trial."""

MAX_TRIALS = 512
"""Of a model with more joints and actuators, the first."""

KICK = 0.5
"""Speed that a degree of freedom begins with [rad/s or m/s]."""

_STREAM = 0x494D504F  # tells what is drawn from what other parts of the recorder draw of the same seed
_FREE_SLIDE_M = 1.0  # an unlimited slide is drawn within that of its reference, a hinge within pi
_TRIES = 200  # draws of a pose without contacts
_CONTROL = 0.5  # of the upper half of a control's range


@dataclass(frozen=True)
class Plan:
    """What is to be tried.

    poses     for the kinematics, states [pose, ...] of the model's fields
    starts    of the trials, states [trial, ...]
    kinds     of each trial: "rest", "joint" or "actuator"
    targets   name of the joint or actuator; empty for "rest"
    controls  [trial, actuator]
    """

    poses: States
    starts: States
    kinds: tuple[str, ...]
    targets: tuple[str, ...]
    controls: NDArray[np.float64]


def plan(scene: ModelScene, *, dt: float, seed: int) -> Plan:
    """What is to be tried with a model.

    Every hinge and slide of a drawn pose is within its limits, or within +-pi rad or +-1 m of its reference; balls and
    free bodies are turned. Trials begin in the middle of all limits, with free bodies lifted off the ground and away
    from each other, or, if bodies touch there, in the first drawn pose in which none do. The first trial is the pose at
    rest; then each degree of freedom has a speed of KICK; then each actuator has a control, half-way between the middle
    and the upper end of its range, or 1. All other speeds and controls are 0.
    """
    compiled = compile_scene(scene, dt=dt, options=own_options(scene))
    model = compiled.model
    held = of_c(model).names
    drawn = _drawn(model, held["joints"], seed)
    poses = drawn[:N_POSE]
    start = _start(model, drawn[N_POSE:])
    kinds, targets = ["rest"], [""]
    for dof in range(model.nv):
        kinds.append("joint")
        targets.append(held["joints"][int(model.dof_jntid[dof])])
    kinds += ["actuator"] * len(held["actuators"])
    targets += held["actuators"]
    kinds, targets = kinds[:MAX_TRIALS], targets[:MAX_TRIALS]
    speeds, controls = np.zeros((len(kinds), model.nv)), np.zeros((len(kinds), model.nu))
    for trial in range(1, len(kinds)):
        if trial <= model.nv:
            speeds[trial, trial - 1] = KICK
        else:
            actuator = trial - 1 - model.nv
            controls[trial, actuator] = _control(model, actuator)
    return Plan(
        _states(compiled, poses, np.zeros((N_POSE, model.nv))),
        _states(compiled, np.tile(start, (len(kinds), 1)), speeds),
        tuple(kinds),
        tuple(targets),
        controls,
    )


def _states(compiled: MjcfModel, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> States:
    return tuple(np.array(array) for array in compiled.split(qpos, qvel))


def _control(model: Any, actuator: int) -> float:
    if not model.actuator_ctrllimited[actuator]:
        return 1.0
    low, high = model.actuator_ctrlrange[actuator]
    return float((low + high) / 2 + _CONTROL * (high - low) / 2)


def _drawn(model: Any, names: Sequence[str], seed: int) -> NDArray[np.float64]:
    # poses [pose, nq]
    qpos = np.tile(model.qpos0, (N_POSE + _TRIES, 1))
    for joint, name in enumerate(names):
        draw = np.random.default_rng(np.random.SeedSequence([_STREAM, seed % 2**64, crc32(name.encode())]))
        kind, at = mjtJoint(int(model.jnt_type[joint])), int(model.jnt_qposadr[joint])
        if kind in (mjtJoint.mjJNT_FREE, mjtJoint.mjJNT_BALL):
            at += 3 if kind == mjtJoint.mjJNT_FREE else 0
            turn = draw.normal(size=(len(qpos), 4))
            qpos[:, at : at + 4] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
        elif model.jnt_limited[joint]:
            qpos[:, at] = draw.uniform(model.jnt_range[joint, 0], model.jnt_range[joint, 1], size=len(qpos))
        else:
            most = np.pi if kind == mjtJoint.mjJNT_HINGE else _FREE_SLIDE_M
            qpos[:, at] += draw.uniform(-most, most, size=len(qpos))
    return np.asarray(qpos)


def _start(model: Any, drawn: NDArray[np.float64]) -> NDArray[np.float64]:
    data = mujoco.MjData(model)
    first = np.asarray(model.qpos0.copy())
    for joint in range(model.njnt):
        single = mjtJoint(int(model.jnt_type[joint])) in (mjtJoint.mjJNT_HINGE, mjtJoint.mjJNT_SLIDE)
        if single and model.jnt_limited[joint]:
            first[int(model.jnt_qposadr[joint])] = model.jnt_range[joint].mean()
    for pose in (first, *drawn):
        data.qpos[:] = _lifted(model, pose)
        mujoco.mj_forward(model, data)
        if not data.ncon:
            return np.array(data.qpos)
    return _lifted(model, first)


def _lifted(model: Any, qpos: NDArray[np.float64]) -> NDArray[np.float64]:
    # free bodies in a row above everything, so that they touch neither the ground nor each other
    row = 2.0 * float(model.stat.extent)
    found, count = qpos.copy(), 0
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mjtJoint.mjJNT_FREE:
            at = int(model.jnt_qposadr[joint])
            found[at] += row * count
            found[at + 2] += row
            count += 1
    return found
