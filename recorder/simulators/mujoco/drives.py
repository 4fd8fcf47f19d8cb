"""What a model's actuators do to its joints, for engines that have joint forces and servos but not MuJoCo's actuators.

Such an engine can be given motors of joints and of fixed tendons, whose force is their control, and position and
velocity servos of a joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.model import actuator_names

_HINGE, _SLIDE = 3, 2  # of mujoco.mjtJoint
_JOINT, _JOINT_IN_PARENT, _TENDON = 0, 1, 3  # of mujoco.mjtTrn
_FIXED_GAIN, _NO_BIAS, _AFFINE_BIAS, _NO_DYNAMICS = 0, 0, 1, 0  # of mujoco.mjtGain, mjtBias, mjtDyn
_JOINT_WRAP = 1  # of mujoco.mjtWrap
_LAST_GROUP = 30  # of actuators, that an option can disable
_POSITION, _VELOCITY = 0, 1  # columns of servo


@dataclass(frozen=True)
class Drives:
    """What actuators do to joints, arrays by actuator [nu] and by velocity [nv].

    low, high              to which controls are clamped
    gain                   force of a control of 1, zero for servos
    force_low, force_high  to which forces are clamped
    arms                   of an actuator on a velocity, [nv, nu]
    servo                  by velocity, the actuators that set its target position and its target velocity; -1: none
    reference              to be subtracted from target positions
    target_of              by velocity, its place in the positions
    """

    low: NDArray[np.float32]
    high: NDArray[np.float32]
    gain: NDArray[np.float32]
    force_low: NDArray[np.float32]
    force_high: NDArray[np.float32]
    arms: NDArray[np.float32]
    servo: NDArray[np.int32]
    reference: NDArray[np.float32]
    target_of: NDArray[np.int32]


@dataclass(frozen=True)
class Places:
    """Where MuJoCo's joints are in an engine's coordinates.

    at_q   by number of the joint, its first number in the positions, and
    at_qd  in the velocities
    count  numbers of the velocities of an environment
    """

    at_q: NDArray[np.int64]
    at_qd: NDArray[np.int64]
    count: int


def drives(model: Any, places: Places, engine: str, *, remedy: str, limited_servos: bool = False) -> Drives:
    """What the actuators of a mujoco.MjModel do to an engine's joints; Refused where that is not possible.

    engine          as a message calls it
    remedy          what a message says to do
    limited_servos  the engine clamps the force of a servo itself
    """
    nv, nu = places.count, model.nu
    for name, count in zip(actuator_names(model), getattr(model, "actuator_ctrlnum", ()), strict=False):
        if count > 1:
            raise Refused(f"{engine} cannot be given actuator '{name}', which has {count} controls; {remedy}")
    unlimited = np.float32(np.inf)
    limited = {name: np.asarray(getattr(model, f"actuator_{name}limited"), dtype=bool) for name in ("ctrl", "force")}
    if disabled(model, "CLAMPCTRL"):
        limited["ctrl"][:] = False
    ends = {
        (name, end): np.where(given, getattr(model, f"actuator_{name}range")[:, end], (2 * end - 1) * unlimited)
        for name, given in limited.items() for end in (0, 1)
    }  # fmt: skip
    gain, arms = np.zeros(nu), np.zeros((nv, nu))
    servo = np.full((nv, 2), -1, dtype=np.int32)
    reference, target_of = np.zeros(nv), np.zeros(nv, dtype=np.int32)
    for joint in range(model.njnt):
        if model.jnt_type[joint] in (_HINGE, _SLIDE):
            reference[places.at_qd[joint]] = model.qpos0[model.jnt_qposadr[joint]]
            target_of[places.at_qd[joint]] = places.at_q[joint]
    alone = "" if limited_servos else " and without a force range"
    for a, name in enumerate(actuator_names(model)):
        if _switched_off(model, a):
            continue
        found = _arms(model, places, a)
        kind = _servo_of(model, a)
        plain = model.actuator_gaintype[a] == _FIXED_GAIN and model.actuator_dyntype[a] == _NO_DYNAMICS
        if found and plain and model.actuator_biastype[a] == _NO_BIAS:
            gain[a] = model.actuator_gainprm[a, 0]
            for place, arm in found.items():
                arms[place, a] = arm
        elif (
            plain and kind is not None and list(found.values()) == [1.0] and (limited_servos or not limited["force"][a])
        ):
            (place,) = found
            if servo[place, kind] >= 0 or (servo[place, 1 - kind] >= 0):
                raise Refused(f"{engine} has one servo a joint, and actuator '{name}' is another on its joint")
            servo[place, kind] = a
        else:
            raise Refused(
                f"{engine} cannot be given actuator '{name}': it takes motors of joints and of fixed tendons "
                f"without actuatorfrcrange, and position and velocity servos of a joint with gear 1{alone}; {remedy}"
            )
    single = np.float32
    return Drives(
        low=ends["ctrl", 0].astype(single),
        high=ends["ctrl", 1].astype(single),
        gain=gain.astype(single),
        force_low=ends["force", 0].astype(single),
        force_high=ends["force", 1].astype(single),
        arms=arms.astype(single),
        servo=servo,
        reference=reference.astype(single),
        target_of=target_of,
    )


def _switched_off(model: Any, a: int) -> bool:
    """Whether an actuator makes no force, by a flag or its group."""
    group = int(model.actuator_group[a])
    of_group = 0 <= group <= _LAST_GROUP and model.opt.disableactuator >> group & 1
    return disabled(model, "ACTUATION") or bool(of_group)


def disabled(model: Any, flag: str) -> bool:
    """Whether a mujoco.MjModel disables what a flag, "GRAVITY", stands for."""
    import mujoco  # whose releases number the flags differently

    return bool(model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")))


def _arms(model: Any, places: Places, a: int) -> dict[int, float]:
    """By place in joint_qd, the arm of an actuator on it; empty where it acts on something else."""
    kind, (target, _) = int(model.actuator_trntype[a]), model.actuator_trnid[a]
    gear = float(model.actuator_gear[a, 0])
    if kind in (_JOINT, _JOINT_IN_PARENT) and model.jnt_type[target] in (_HINGE, _SLIDE):
        return {int(places.at_qd[target]): gear}
    if kind == _TENDON and not model.tendon_actfrclimited[target]:
        first, count = model.tendon_adr[target], model.tendon_num[target]
        wraps = range(first, first + count)
        if all(model.wrap_type[w] == _JOINT_WRAP for w in wraps):
            return {int(places.at_qd[model.wrap_objid[w]]): gear * float(model.wrap_prm[w]) for w in wraps}
    return {}


def _servo_of(model: Any, a: int) -> int | None:
    """Whether an actuator is a position servo, kp (ctrl - q) - kv qd, or a velocity servo, kv (ctrl - qd)."""
    if model.actuator_biastype[a] != _AFFINE_BIAS or model.actuator_trntype[a] != _JOINT:
        return None
    gain, (constant, kp, kv) = model.actuator_gainprm[a, 0], model.actuator_biasprm[a, :3]
    if constant == 0 and kp == -gain:
        return _POSITION
    return _VELOCITY if constant == 0 and kp == 0 and kv == -gain else None
