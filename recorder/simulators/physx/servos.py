"""The drives of a model's joints in PhysX, and what the model's controls make of them.

A joint has one drive: stiffness (target - position) + damping (target velocity - velocity), implicit in time. Springs
and damping of MuJoCo's joints and its position and velocity servos are all of this form, so that a drive is their sum.
Motors are forces beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.simulators.mujoco.drives import Drives, Places, drives

TARGETS = ("POSITION_TARGET", "VELOCITY_TARGET", "ACTUATION_FORCE")
"""PhysX's tensors of degrees of freedom that controls change."""

_POSITION, _VELOCITY = 0, 1  # columns of Drives.servo
_SINGLE = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))


@dataclass(frozen=True)
class Servo:
    """The drive of a joint [N m, rad or N, m]; positions are those of PhysX, zero in the reference state.

    stiffness, damping  its gains, springs and damping of the joint included
    rest                position that the spring alone draws to
    most                force that it can have; inf: any
    kp, kv              shares of the gains that an actuator's control acts on
    hold                damping that a position servo brings
    """

    stiffness: float
    damping: float
    rest: float
    most: float
    kp: float
    kv: float
    hold: float


class Driven:
    """What controls do to the joints of a model.

    servos  by MuJoCo's joint
    uses    names of PhysX's tensors that controls change
    """

    def __init__(self, model: Any, engine: str, remedy: str, *, springs: bool = True) -> None:
        """Refused where the model's actuators are others than motors, and servos of joints; engine, remedy as of
        `drives`; springs: whether springs and damping of joints are part of their drives."""
        self._springs = springs
        singles = [j for j in range(model.njnt) if model.jnt_type[j] in _SINGLE]
        places = Places(np.asarray(model.jnt_qposadr), np.asarray(model.jnt_dofadr), model.nv)
        self._made: Drives = drives(model, places, engine, remedy=remedy, limited_servos=True)
        self._limits = np.full((model.nv, 2), (-np.inf, np.inf))
        self.servos = {j: self._servo(model, j, engine) for j in singles}
        used = {
            "POSITION_TARGET": (self._made.servo[:, _POSITION] >= 0).any(),
            "VELOCITY_TARGET": (self._made.servo[:, _VELOCITY] >= 0).any(),
            "ACTUATION_FORCE": self._made.arms.any(),
        }
        self.uses = frozenset(name for name, is_used in used.items() if is_used)

    def _servo(self, model: Any, joint: int, engine: str) -> Servo:
        dof, made = int(model.jnt_dofadr[joint]), self._made
        stiffness, damping = float(model.jnt_stiffness[joint]), float(model.dof_damping[dof])
        if not self._springs:
            stiffness = damping = 0.0
        reference = float(model.qpos0[model.jnt_qposadr[joint]])
        rest = float(model.qpos_spring[model.jnt_qposadr[joint]]) - reference
        kp = kv = hold = 0.0
        most = math.inf
        name = model.joint(joint).name or f"joint{joint}"
        for kind, actuator in enumerate(made.servo[dof]):
            if actuator < 0:
                continue
            if kind == _POSITION:
                kp, hold = float(model.actuator_gainprm[actuator, 0]), -float(model.actuator_biasprm[actuator, 2])
            else:
                kv = float(model.actuator_gainprm[actuator, 0])
            if model.actuator_forcelimited[actuator]:
                low, high = map(float, model.actuator_forcerange[actuator])
                if low != -high or stiffness or damping:
                    raise Refused(
                        f"{engine} limits the sum of spring, damping and servo of joint '{name}' alike in both "
                        "directions, and its actuator has a force range of its own"
                    )
                most = high
        if model.jnt_actfrclimited[joint]:
            if kp or kv or hold:
                raise Refused(f"{engine} has no actuatorfrcrange for joint '{name}', which has a servo")
            self._limits[dof] = model.jnt_actfrcrange[joint]
        return Servo(stiffness + kp, damping + kv + hold, rest, most, kp, kv, hold)

    def of(self, model: Any, joints: Sequence[int], controls: NDArray[np.floating]) -> dict[str, NDArray[np.float32]]:
        """Position targets, velocity targets and forces, [..., joint], for controls [..., actuator]; by the names of
        PhysX's tensors."""
        made = self._made
        given = np.clip(np.asarray(controls, dtype=np.float64), made.low, made.high)
        forces = np.clip(given * made.gain, made.force_low, made.force_high) @ made.arms.T.astype(np.float64)
        forces = np.clip(forces, *self._limits.T)
        shape = (*given.shape[:-1], len(joints))
        found = {name: np.zeros(shape) for name in TARGETS}
        for column, joint in enumerate(joints):
            dof, servo = int(model.jnt_dofadr[joint]), self.servos[joint]
            position, velocity = (made.servo[dof][kind] for kind in (_POSITION, _VELOCITY))
            target: Any = (servo.stiffness - servo.kp) * servo.rest
            if position >= 0:
                target = target + servo.kp * (given[..., position] - made.reference[dof])
            found["POSITION_TARGET"][..., column] = target / servo.stiffness if servo.stiffness else 0.0
            if velocity >= 0 and servo.damping:
                found["VELOCITY_TARGET"][..., column] = servo.kv / servo.damping * given[..., velocity]
            found["ACTUATION_FORCE"][..., column] = forces[..., dof]
        return {name: array.astype(np.float32) for name, array in found.items()}
