"""How a model is tried on an engine: drawn poses for its kinematics, single impulses and controls for its dynamics,
and a drop to the ground from its first state, without controls, past the first contact.

All engines are given the same numbers, which depend on the model's files and the seed alone. What is drawn for a joint
depends on its name and limits, and on no other joint, so that copies of a model with one difference are tried alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any
from zlib import crc32

import mujoco
import numpy as np
from mujoco import mjtJoint
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene, control_names
from gpusimbench.recorder.simulators.base import Simulator, States
from gpusimbench.recorder.simulators.mujoco.imported import of_c
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import own_options
from gpusimbench.schemas.imported import Drop

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

AFTER_S = 0.5
"""How long the drop goes on after the first contact of MuJoCo C [s]."""

_LONGEST_S = 2.0  # that the first contact is waited for
_MOST_STEPS = 4000
_BLOCK = 10  # steps that are asked for at once


@dataclass(frozen=True)
class TrialPlan:
    """What is to be tried.

    poses     for the kinematics, states [pose, ...] of the model's fields
    starts    of the trials, states [trial, ...]
    kinds     of each trial: "rest", "joint" or "actuator"
    targets   name of the joint or of the control (control_names); empty for "rest"
    controls  [trial, actuator]
    """

    poses: States
    starts: States
    kinds: tuple[str, ...]
    targets: tuple[str, ...]
    controls: NDArray[np.float64]


def plan(scene: ModelScene, *, dt: float, seed: int) -> TrialPlan:
    """What is to be tried with a model.

    Every hinge and slide of a drawn pose is within its limits, or within +-pi rad or +-1 m of its reference; balls and
    free bodies are turned. Trials begin in the middle of all limits, with free bodies lifted off the ground and away
    from each other, or, if bodies touch there, in the first drawn pose in which none do. The first trial is the pose at
    rest; then each degree of freedom has a speed of KICK; then each control in turn is half-way between the middle
    and the upper end of its range, or is 1. All other speeds and controls are 0.
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
    actuated = control_names(model)
    kinds += ["actuator"] * len(actuated)
    targets += actuated
    kinds, targets = kinds[:MAX_TRIALS], targets[:MAX_TRIALS]
    speeds, controls = np.zeros((len(kinds), model.nv)), np.zeros((len(kinds), model.nu))
    for trial in range(1, len(kinds)):
        if trial <= model.nv:
            speeds[trial, trial - 1] = KICK
        else:
            control = trial - 1 - model.nv
            controls[trial, control] = _control(model, control)
    return TrialPlan(
        _states(compiled, poses, np.zeros((N_POSE, model.nv))),
        _states(compiled, np.tile(start, (len(kinds), 1)), speeds),
        tuple(kinds),
        tuple(targets),
        controls,
    )


def _states(compiled: MjcfModel, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> States:
    return tuple(np.array(array) for array in compiled.split(qpos, qvel))


def _control(model: Any, control: int) -> float:
    if not model.actuator_ctrllimited[control]:
        return 1.0
    low, high = model.actuator_ctrlrange[control]
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


def dropped(scene: ModelScene, make: Callable[[Scene, int], Simulator], *, dt: float) -> Drop | None:
    """What a simulator of its own, with one environment, does with the model; None for a model that has no free body,
    that no gravity pulls down, or that on MuJoCo C touches nothing within 2 s.

    What engines tell of contacts differs, and some tell nothing. So contacts, the centre of mass and the momentum are
    computed by MuJoCo C's model from the states that an engine gives: the force that carries the model is its weight
    and what its momentum gains.

    make  a simulator that was not built yet, of a scene and a number of environments
    """
    still = replace(scene, actions=None, controls="none")
    compiled = compile_scene(still, dt=dt, options=own_options(still))
    n_step = _steps(compiled, dt)
    if not n_step:
        return None
    simulator = make(still, 1)
    try:
        description = simulator.build()
        simulator.compile("capture")
        simulator.reserve(_BLOCK)
        simulator.prepare(None)
        rows = [tuple(np.array(array) for array in simulator.state())]
        for first in range(0, n_step, _BLOCK):
            block = simulator.states(min(_BLOCK, n_step - first))
            rows += [tuple(np.array(array[step]) for array in block) for step in range(len(block[0]))]
    finally:
        simulator.close()
    origin = np.array(description.env_origins[0]) if description.env_origins else np.zeros(3)
    world = [field.field == "position" and field.frame == "world" for field in description.fields]
    found = [tuple(a - origin if w else a for a, w in zip(row, world, strict=True)) for row in rows]
    return measured(compiled, found, dt)


def measured(compiled: MjcfModel, rows: list[States], dt: float) -> Drop:
    """Contacts, height and momentum of states [1, item, width] of the model's fields, `dt` apart [s]."""
    model = compiled.model
    moves = model.body_weldid != 0
    mass = model.body_mass * moves
    data = mujoco.MjData(model)
    contact, height, momentum = [], [], []
    for row in rows:
        qpos, qvel = compiled.joined(row)
        if not (np.isfinite(qpos).all() and np.isfinite(qvel).all()):
            contact.append(False)
            height.append(np.nan)
            momentum.append(np.nan)
            continue
        data.qpos[:], data.qvel[:] = qpos[0], qvel[0]
        for compute in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_collision, mujoco.mj_comVel):
            compute(model, data)
        mujoco.mj_subtreeVel(model, data)
        contact.append(_touches(model, data))
        height.append(float(mass @ data.xipos[:, 2] / mass.sum()))
        momentum.append(float(model.body_subtreemass[0] * data.subtree_linvel[0, 2]))
    weight = float(-mass @ np.full(model.nbody, model.opt.gravity[2]))
    return Drop(np.arange(len(rows)) * dt, np.array(contact), np.array(height), np.array(momentum), weight)


def _steps(compiled: MjcfModel, dt: float) -> int:
    free = (compiled.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).any()
    if not free or compiled.model.opt.gravity[2] >= 0:
        return 0  # a base carries it, or nothing falls
    after = round(AFTER_S / dt)
    longest = min(round(_LONGEST_S / dt), _MOST_STEPS - after)
    for step, data in enumerate(compiled.rollout(n_step=max(longest, 0))):
        if _touches(compiled.model, data):
            return step + after
    return 0


def _touches(model: Any, data: Any) -> bool:
    # whether a shape that moves reaches into one that does not
    fixed = model.body_weldid[model.geom_bodyid[data.contact.geom]] == 0  # [contact, 2]
    return bool((fixed.any(axis=1) & (data.contact.dist < 0)).any()) if data.ncon else False
