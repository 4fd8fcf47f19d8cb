"""N worlds of a scene in Newton: the model, its solver, its collision detection and its two states."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.newton.model import build_model
from gpusimbench.recorder.simulators.newton.options import NewtonOptions
from gpusimbench.recorder.simulators.newton.solvers import Sizes, make_solver, register
from gpusimbench.recorder.simulators.snapshot import Envs
from gpusimbench.recorder.simulators.warp import worlds

_STATE = ("body_q", "body_qd", "joint_q", "joint_qd")
"""Arrays of a newton.State that a step may read; forces are cleared before it."""


class Worlds:
    """N worlds in the scene's first state.

    model     newton.Model
    solver    a newton solver
    pipeline  newton.CollisionPipeline, and
    contacts  the buffer that it fills; both None where the solver detects collisions itself
    warnings  what the engine had to say of all this
    parity    which of the two states is the present one: a step reads it and writes the other
    """

    def __init__(
        self, scene: Scene, *, n_env: int, dt: float, options: NewtonOptions, sizes: Sizes, mode: Any, ordered: bool
    ) -> None:
        """Allocate everything on Warp's present device.

        mode     warp.DeterministicMode of the solver
        ordered  whether collision detection puts its contacts in order
        """
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            warnings.simplefilter("ignore", DeprecationWarning)  # of the engine against itself
            self._allocate(scene, n_env, options, sizes, mode, ordered)
        self.warnings = tuple(dict.fromkeys(str(warning.message) for warning in caught))
        self._dt = dt / options.substeps
        self.parity = 0

    def _allocate(
        self, scene: Scene, n_env: int, options: NewtonOptions, sizes: Sizes, mode: Any, ordered: bool
    ) -> None:
        import newton

        self.n_env = n_env
        self.model = build_model(scene, n_env=n_env, options=options, register=register(options))
        self.model.rigid_contact_max = n_env * sizes.contacts  # before any solver sizes its own buffers by it
        self.solver = make_solver(self.model, options, sizes, mode)
        self.pipeline: Any = None
        self.contacts: Any = None
        if options.own_contacts:  # what it would print of its buffers is watched and recorded
            self.pipeline = newton.CollisionPipeline(self.model, deterministic=ordered, verify_buffers=False)
            self.contacts = self.pipeline.contacts()
        self._states = (self.model.state(), self.model.state())
        for state in self._states:
            newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, state)
        self._control = self.model.control()

    @property
    def state(self) -> Any:
        """The present newton.State."""
        return self._states[self.parity]

    def substep(self) -> None:
        """Enqueue one step of the solver."""
        before, after = self._states[self.parity], self._states[1 - self.parity]
        before.clear_forces()
        if self.pipeline is not None:
            self.pipeline.collide(before, self.contacts)
        self.solver.step(before, after, self._control, self.contacts, self._dt)
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
                whole.reshape(self.n_env, -1)[slice(None) if envs is None else envs] = rows
                target.assign(whole)
        if data := self._mjw:
            inner = {name.removeprefix("mjw."): rows for name, rows in arrays.items() if name.startswith("mjw.")}
            worlds.assign(data, inner, envs)

    def place(self, poses: NDArray[np.floating], speeds: NDArray[np.floating], envs: Envs) -> None:
        """Give the bodies of these worlds poses [env of envs, body, 7], xyzw, and speeds [env of envs, body, 6]."""
        import newton

        present = {"present.body_q": poses.reshape(len(poses), -1), "present.body_qd": speeds.reshape(len(speeds), -1)}
        self.put(present, envs)
        state = self.state
        joint_q, joint_qd = (array.numpy().reshape(self.n_env, -1) for array in (state.joint_q, state.joint_qd))
        newton.eval_ik(self.model, state, state.joint_q, state.joint_qd)
        rows = slice(None) if envs is None else envs
        for array, before in ((state.joint_q, joint_q.copy()), (state.joint_qd, joint_qd.copy())):
            whole = array.numpy().reshape(self.n_env, -1)
            before[rows] = whole[rows]  # the others' joints keep their bits
            array.assign(before.reshape(array.shape))

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
