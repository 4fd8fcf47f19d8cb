"""N worlds of a scene in Newton: the model, its solver, its collision detection and its two states."""

from __future__ import annotations

import warnings
from typing import Any

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.newton.model import build_model
from gpusimbench.recorder.simulators.newton.options import NewtonOptions
from gpusimbench.recorder.simulators.newton.solvers import Sizes, make_solver, register


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
