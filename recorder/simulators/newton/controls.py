"""The controls of a model's actuators on the device, and what they do in Newton.

Solver mujoco has MuJoCo's actuators, which are given their controls. The other solvers have joint forces, and a servo
at each hinge and slide: of MuJoCo's actuators they can be given those whose force is their control, and position and
velocity servos of a joint.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.mujoco.drives import Places, drives
from gpusimbench.recorder.simulators.newton.imported import Imported
from gpusimbench.recorder.simulators.newton.options import NewtonOptions
from gpusimbench.recorder.simulators.warp.runtime import DeviceActions
from gpusimbench.schemas.action_generator import Streams


class ModelControls:
    """Controls of n_env worlds.

    ctrl   [env, actuator] on the device
    drawn  where they come from
    """

    def __init__(
        self, scene: Scene, seed: int, streams: Streams, imported: Imported, mujoco_model: Any, control: Any,
        options: NewtonOptions, n_env: int,
    ) -> None:  # fmt: skip
        """Refused where the solver cannot be given an actuator, or the importer left one out.

        mujoco_model  the same model as MuJoCo compiles it
        control       newton.Control
        """
        import warp as wp

        assert scene.actions is not None
        self.drawn = DeviceActions(scene.actions, seed, streams)
        self._driven: list[Any] = []
        if options.solver == "mujoco":
            flat = control.mujoco.ctrl
            if flat.size != n_env * mujoco_model.nu:
                raise Refused(
                    f"Newton's importer takes {flat.size // n_env} of the model's {mujoco_model.nu} actuators"
                )
            self.ctrl = flat.reshape((n_env, mujoco_model.nu))
            return
        self.ctrl = wp.zeros((n_env, mujoco_model.nu), dtype=float)
        places = Places(imported.at_q, imported.at_qd, imported.builder.joint_dof_count)
        engine = f"solver '{options.solver}' of Newton"
        made = drives(mujoco_model, places, engine, remedy="use --option solver=mujoco")
        self._inputs = [wp.array(getattr(made, one.name)) for one in fields(made)]
        arrays = control.joint_f, control.joint_target_q, control.joint_target_qd
        self._driven = [array.reshape((n_env, -1)) for array in arrays]

    def enqueue(self) -> None:
        """Enqueue: the controls of the next step, and what they do."""
        import warp as wp

        from gpusimbench.recorder.simulators.newton import kernels

        self.drawn.enqueue(self.ctrl)
        if self._driven:
            shape = self._driven[0].shape
            wp.launch(kernels.drive_joints, dim=shape, inputs=[self.ctrl, *self._inputs], outputs=self._driven)
