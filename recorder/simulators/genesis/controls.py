"""What the controls of a model's actuators do to Genesis' degrees of freedom.

A degree of freedom of Genesis is in one of three modes: a force, a target position of a servo or a target velocity of
a servo. Of MuJoCo's actuators it can be given what recorder.simulators.mujoco.drives makes of them. A force beside a
servo moves the servo's target by the force over its gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.simulators.genesis.environments import Drive, on_device
from gpusimbench.recorder.simulators.mujoco.drives import Drives, Places, drives

_ENGINE, _REMEDY = "Genesis", "MuJoCo's engines take such models"
_POSITION, _VELOCITY = 0, 1  # columns of Drives.servo


class Controls:
    """Actuators of a mujoco.MjModel on Genesis."""

    def __init__(self, model: Any) -> None:
        """Refused where an actuator cannot be given."""
        self._model = model
        places = Places(np.asarray(model.jnt_qposadr), np.asarray(model.jnt_dofadr), model.nv)
        made: Drives = drives(model, places, _ENGINE, remedy=_REMEDY, limited_servos=True)
        self._made = made
        self._singles = {
            int(places.at_qd[j]): j for j in range(model.njnt) if model.jnt_type[j] in (2, 3)
        }  # slides and hinges, of mujoco.mjtJoint
        pushed = np.asarray(made.arms.any(axis=1))
        self._servos = [np.flatnonzero(made.servo[:, kind] >= 0) for kind in (_POSITION, _VELOCITY)]
        self._gains = [
            np.array([model.actuator_gainprm[made.servo[dof, kind], 0] for dof in dofs], dtype=np.float64)
            for kind, dofs in enumerate(self._servos)
        ]
        for kind, dofs in enumerate(self._servos):
            for dof, gain in zip(dofs, self._gains[kind], strict=True):
                if pushed[dof] and (model.actuator_forcelimited[made.servo[dof, kind]] or not gain > 0):
                    name = model.joint(self._singles[int(dof)]).name or f"joint{self._singles[int(dof)]}"
                    raise Refused(
                        f"{_ENGINE} limits the force of a joint, and joint '{name}' has a motor beside a servo with "
                        f"a limit of its own, or no gain; {_REMEDY}"
                    )
        self._motors = np.flatnonzero(pushed & (made.servo < 0).all(axis=1))
        self._limits = np.full((model.nv, 2), (-np.inf, np.inf))
        for single, joint in self._singles.items():
            if model.jnt_actfrclimited[joint]:
                self._limits[single] = model.jnt_actfrcrange[joint]

    def prepare(self, solver: Any) -> None:
        """Set the gains and force ranges of servos. The importer's, which are of one actuator a joint, are taken from
        motors, whose forces are clamped here."""
        model = self._model
        dofs = np.array(sorted(self._singles), dtype=np.int64)
        if not len(dofs):
            return
        kp, kv = np.zeros(len(dofs)), np.zeros(len(dofs))
        limits = np.full((len(dofs), 2), (-np.inf, np.inf))
        for row, dof in enumerate(dofs):
            for kind, actuator in enumerate(self._made.servo[dof]):
                if actuator < 0:
                    continue
                if kind == _POSITION:
                    kp[row] = model.actuator_gainprm[actuator, 0]
                kv[row] = -model.actuator_biasprm[actuator, 2]
                force = (-np.inf, np.inf)
                if model.actuator_forcelimited[actuator]:
                    force = tuple(model.actuator_forcerange[actuator])
                limits[row] = np.clip(force, *self._limits[dof])
        solver.set_dofs_act_gain(on_device(kp), dofs)
        solver.set_dofs_act_bias(*map(on_device, (np.zeros_like(kp), -kp, -kv)), dofs)
        solver.set_dofs_force_range(*map(on_device, limits.T), dofs)

    def drives(self, solver: Any, controls: NDArray[np.floating]) -> Sequence[Drive]:
        """What controls [step, env, actuator] make the solver do."""
        made = self._made
        given = np.clip(np.asarray(controls, dtype=np.float64), made.low, made.high)
        forces = np.clip(given * made.gain, made.force_low, made.force_high) @ made.arms.T.astype(np.float64)
        forces[..., self._motors] = np.clip(forces[..., self._motors], *self._limits[self._motors].T)
        moved: list[tuple[Any, NDArray[np.float64], NDArray[np.int64]]] = [
            (solver.control_dofs_force, forces[..., self._motors], self._motors)
        ]
        controls_of = (solver.control_dofs_position, solver.control_dofs_velocity)
        for kind, (dofs, gain) in enumerate(zip(self._servos, self._gains, strict=True)):
            targets = given[..., made.servo[dofs, kind]] - (made.reference[dofs] if kind == _POSITION else 0.0)
            moved.append((controls_of[kind], targets + forces[..., dofs] / np.where(gain > 0, gain, 1.0), dofs))
        return [Drive(control, on_device(values), dofs) for control, values, dofs in moved if len(dofs)]
