"""N worlds in Newton: the model, its solver, its collision detection, its two states, and the controls of a model's
actuators."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.mujoco.drives import Places, drives
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.recorder.simulators.newton.imported import Imported
from gpusimbench.recorder.simulators.newton.model import World, build_model
from gpusimbench.recorder.simulators.newton.options import JOINT_SPACE, NewtonOptions
from gpusimbench.recorder.simulators.newton.solvers import NewtonSizes, make_solver, register
from gpusimbench.recorder.simulators.snapshot import Envs, rows_of
from gpusimbench.recorder.simulators.warp import worlds
from gpusimbench.recorder.simulators.warp.runtime import DeviceActions
from gpusimbench.schemas.action_generator import Streams

_STATE = ("body_q", "body_qd", "joint_q", "joint_qd")
"""Arrays of a newton.State that a step may read; forces are cleared before it."""

_MEASURED = (
    "states of joints are measured from the poses of bodies (newton.eval_ik), which may be off their joints: "
    "environments that are set to a recorded state (--initial, --intervene set) have their bodies on them"
)
"""Remark of recordings by solvers that move bodies, not joint coordinates."""


class ModelControls:
    """Controls of n_env worlds, on the device.

    Solver mujoco has MuJoCo's actuators, which are given their controls. The other solvers have joint forces, and a
    servo at each hinge and slide: of MuJoCo's actuators they can be given those whose force is their control, and
    position and velocity servos of a joint.

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


class Worlds:
    """N worlds in the scene's first state.

    model     newton.Model
    solver    a newton solver
    pipeline  newton.CollisionPipeline, and
    contacts  the buffer that it fills; both None where the solver detects collisions itself
    layout    where the fields of a recording are in its arrays
    control   newton.Control
    controls  what is written into it at each step; None where that is nothing
    remarks   what the engine had to say of all this, and what recorded states do not have
    parity    which of the two states is the present one: a step reads it and writes the other
    """

    def __init__(
        self,
        world: World,
        *,
        n_env: int,
        dt: float,
        options: NewtonOptions,
        physics: MjcfOptions | None,
        sizes: NewtonSizes,
        mode: Any,
        ordered: bool,
    ) -> None:
        """Allocate everything on Warp's present device.

        physics  options of MuJoCo's physics that the MJCF asks for; None of scenes that do not come as MJCF
        mode     warp.DeterministicMode of the solver
        ordered  whether collision detection puts its contacts in order
        """
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            warnings.simplefilter("ignore", DeprecationWarning)  # of the engine against itself
            self._allocate(world, n_env, options, physics, sizes, mode, ordered)
        self.remarks = tuple(dict.fromkeys(str(warning.message) for warning in caught))
        if self._measured is not None:
            self.remarks += (_MEASURED,)
        self._dt = dt / options.substeps
        self.parity = 0
        self.controls: ModelControls | None = None

    def _allocate(
        self,
        world: World,
        n_env: int,
        options: NewtonOptions,
        physics: MjcfOptions | None,
        sizes: NewtonSizes,
        mode: Any,
        ordered: bool,
    ) -> None:
        import newton

        self.n_env = n_env
        self.layout = world.layout
        self.model = build_model(world, n_env=n_env, options=options, register=register(options))
        self.model.rigid_contact_max = n_env * sizes.contacts  # before any solver sizes its own buffers by it
        self.solver = make_solver(self.model, options, physics, sizes, mode, multiccd=world.multiccd)
        self.pipeline: Any = None
        self.contacts: Any = None
        if options.own_contacts:  # what it would print of its buffers is watched and recorded
            self.pipeline = newton.CollisionPipeline(self.model, deterministic=ordered, verify_buffers=False)
            self.contacts = self.pipeline.contacts()
        self._states = (self.model.state(), self.model.state())
        for state in self._states:
            newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, state)
        self.control = self.model.control()
        self._measured: tuple[Any, Any] | None = None
        if self.layout.names[0] == "joint_q" and options.solver not in JOINT_SPACE:
            import warp as wp

            self._measured = wp.clone(self.model.joint_q), wp.clone(self.model.joint_qd)

    @property
    def state(self) -> Any:
        """The present newton.State."""
        return self._states[self.parity]

    def shown(self) -> tuple[Any, Any]:
        """The present state's two arrays of the layout. Enqueued: solvers that move bodies alone have no coordinates of
        joints, so that these are measured."""
        import newton

        state = self.state
        if self._measured is not None:
            newton.eval_ik(self.model, state, *self._measured)
            return self._measured
        positions, velocities = (getattr(state, name) for name in self.layout.names)
        return positions, velocities

    def act(self) -> None:
        """Enqueue what actuators are given in the next step."""
        if self.controls is not None:
            self.controls.enqueue()

    def substep(self) -> None:
        """Enqueue one step of the solver."""
        before, after = self._states[self.parity], self._states[1 - self.parity]
        before.clear_forces()
        if self.pipeline is not None:
            self.pipeline.collide(before, self.contacts)
        self.solver.step(before, after, self.control, self.contacts, self._dt)
        self.parity = 1 - self.parity

    def kept(self) -> dict[str, NDArray[Any]]:
        """The arrays of both states and, of solver mujoco, what decides its next step: copies [env, ...] by name."""
        rows = {name: array.numpy().reshape(self.n_env, -1) for name, array in self._arrays().items()}
        solver = {f"mjw.{name}": array for name, array in worlds.kept(data).items()} if (data := self._mjw) else {}
        return {name: np.array(array) for name, array in rows.items()} | solver

    def put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
        """Write rows of such arrays, [env of envs, ...]; what solvers keep to themselves of these worlds is cleared."""
        self._clear_solver(envs)
        targets = self._arrays()
        for name, rows in arrays.items():
            if name in targets:
                target = targets[name]
                whole = target.numpy()
                whole.reshape(self.n_env, -1)[rows_of(envs)] = rows
                target.assign(whole)
        if data := self._mjw:
            inner = {name.removeprefix("mjw."): rows for name, rows in arrays.items() if name.startswith("mjw.")}
            worlds.assign(data, inner, envs)

    def place(self, positions: NDArray[np.floating], velocities: NDArray[np.floating], envs: Envs) -> None:
        """Give these worlds a state: the two arrays of the layout, [env of envs, number]."""
        import newton

        given = dict(zip(self.layout.names, (positions, velocities), strict=True))
        self.put({f"present.{name}": array for name, array in given.items()}, envs)
        state = self.state
        followers = [name for name in _STATE if name not in given]  # what follows from what was given
        before = {name: getattr(state, name).numpy().reshape(self.n_env, -1).copy() for name in followers}
        if "joint_q" in given:
            newton.eval_fk(self.model, state.joint_q, state.joint_qd, state)
        else:
            newton.eval_ik(self.model, state, state.joint_q, state.joint_qd)
        chosen = rows_of(envs)
        for name, whole in before.items():
            array = getattr(state, name)
            whole[chosen] = array.numpy().reshape(self.n_env, -1)[chosen]  # the others keep their bits
            array.assign(whole.reshape(array.numpy().shape))

    @property
    def _mjw(self) -> Any:
        # the mujoco_warp.Data of solver mujoco; None of others
        return getattr(self.solver, "mjw_data", None)

    def _arrays(self) -> dict[str, Any]:
        # of the state that the next step reads, and of the one that it writes
        both = (("present", self.state), ("other", self._states[1 - self.parity]))
        return {
            f"{which}.{name}": array
            for which, state in both
            for name in _STATE
            if (array := getattr(state, name, None)) is not None and array.size
        }

    def _clear_solver(self, envs: Envs) -> None:
        import warp as wp

        chosen = np.zeros(self.n_env + 1, dtype=bool)  # the last is for what belongs to no world
        chosen[slice(self.n_env) if envs is None else envs] = True
        saved = {name: array.numpy().copy() for name, array in self._arrays().items()}
        self.solver.reset(self.state, wp.array(chosen, dtype=wp.bool))
        for name, array in self._arrays().items():  # some solvers reset poses too, those of all worlds among them
            array.assign(saved[name])
