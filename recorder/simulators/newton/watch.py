"""What Newton's solvers show of their work: counts of a step, how much room buffers
get, and what did not fit into one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.simulators.buffer_sizes import Need, measure
from gpusimbench.recorder.simulators.evidence import (
    CONSTRAINT_ROWS,
    CONTACTS,
    MISPLACED_CONTACTS,
    SOLVER_ITERATIONS,
)
from gpusimbench.recorder.simulators.mujoco.model import MjcfModel, compile_scene
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions
from gpusimbench.recorder.simulators.newton.model import detection_distance
from gpusimbench.recorder.simulators.newton.options import NewtonOptions
from gpusimbench.recorder.simulators.newton.solvers import NewtonSizes
from gpusimbench.recorder.simulators.newton.worlds import Worlds
from gpusimbench.recorder.simulators.warp.transfer import count_misplaced
from gpusimbench.schemas.provenance import Buffer, Counter, OverflowBit

_MARGIN = 1.5  # Newton's collision detection makes other contacts of the same shapes, and its solvers other motions
_STEEL_ROWS = 2  # of a contact: one along its normal, and its part of what a patch of contacts has along the surface


def choose_sizes(scene: Scene, *, dt: float, seed: int, options: NewtonOptions, physics: MjcfOptions) -> NewtonSizes:
    """Room for what MuJoCo C needs of the same scene with these options of its physics, and a margin; options that ask
    for a size get it."""
    compiled = compile_scene(scene, dt=dt, options=physics)
    compiled.model.geom_gap[:] = detection_distance(options)
    need = measure(compiled, dt=dt, seed=seed)
    if options.own_contacts:
        need = replace(need, margin=_MARGIN)
    # MuJoCo's pool holds pairs of shapes before it holds contacts
    contacts = need.contacts if options.own_contacts else need.pool
    match options.solver:
        case "steel":
            rows = _STEEL_ROWS * need.contacts
        case "vbd":
            rows = _contacts_of_a_body(compiled, need)
        case _:
            rows = need.rows
    return NewtonSizes(
        contacts=options.max_contacts or need.size(contacts),
        rows=options.max_rows or need.size(rows),
        contacts_by="asked for" if options.max_contacts else need.sized_by(contacts),
        rows_by="asked for" if options.max_rows else need.sized_by(rows),
    )


def _contacts_of_a_body(compiled: MjcfModel, need: Need) -> int:
    """The contacts of the moving body that has most of them, at any step."""
    body_of = np.asarray(compiled.model.geom_bodyid)
    most = 0
    for data in compiled.rollout(n_step=need.steps):
        bodies = body_of[np.asarray(data.contact.geom).reshape(-1)]
        most = max(most, int(np.bincount(bodies[bodies > 0], minlength=1).max()))
    return most


_NOT_FATAL = ("ITERATIONS", "LS_ITERATIONS")  # nothing is dropped
_CONTACT_PIPELINE, _SOLVER_NCONMAX = 16, 17  # as in newton.solvers.SolverMuJoCo.OverflowBits
_CONTACT_BUFFER, _SOLVER_BUFFER = 0, 1  # of the other solvers, which have no bits of their own

Count = Callable[[Any, Any], None]


class Watch:
    """Kernels around the steps of some worlds.

    bits  what was seen in each world since it was last stored, [world] on the device
    """

    def __init__(self, worlds: Worlds, options: NewtonOptions, sizes: NewtonSizes) -> None:
        import warp as wp

        self._worlds = worlds
        self._sizes = sizes
        self._options = options
        self.bits = wp.zeros(worlds.n_env, dtype=wp.int32)
        self.overflow_bits: tuple[OverflowBit, ...] = ()
        self.buffers: tuple[Buffer, ...] = ()
        self._gathers: list[Callable[[], None]] = []
        self._counts: list[tuple[Counter, Count]] = []
        if options.solver == "mujoco":
            self._watch_mujoco()
        else:
            self._watch_pool(_CONTACT_BUFFER, "CONTACT_BUFFER")
            self._watch_solver()

    @property
    def counters(self) -> tuple[Counter, ...]:
        """What is counted, in the order of `count`."""
        return tuple(counter for counter, _ in self._counts)

    def gather(self) -> None:
        """Enqueue: keep what the last step of the solver showed."""
        for gather in self._gathers:
            gather()

    def count(self, row: Any, stored: tuple[Any, ...]) -> None:
        """Enqueue: count the last step into a row of the arrays [row, world], one for each counter."""
        for (_, count), array in zip(self._counts, stored, strict=True):
            count(row, array)

    def _launch(self, kernel: Any, dim: int, *inputs: Any) -> None:
        import warp as wp

        wp.launch(kernel, dim=dim, inputs=list(inputs))

    def _watch_mujoco(self) -> None:
        import mujoco_warp as mjw

        from gpusimbench.recorder.simulators.newton import kernels

        n_env, data, sizes = self._worlds.n_env, self._worlds.solver.mjw_data, self._sizes
        self.overflow_bits = tuple(
            OverflowBit(int(bit).bit_length() - 1, bit.name, fatal=bit.name not in _NOT_FATAL)
            for bit in mjw.OverflowType
            if int(bit).bit_count() == 1
        )
        self.buffers = (
            Buffer("nconmax", data.naconmax // n_env, "env", CONTACTS.name, sizes.contacts_by),
            Buffer("njmax", data.njmax, "env", CONSTRAINT_ROWS.name, sizes.rows_by),
        )
        self._gathers.append(lambda: self._launch(kernels.gather_bits, n_env, data.overflow, self.bits))
        if self._worlds.pipeline is not None:
            self._watch_pool(_CONTACT_PIPELINE, "CONTACT_PIPELINE", counted=False)
            self.overflow_bits += (OverflowBit(_SOLVER_NCONMAX, "SOLVER_NCONMAX", fatal=True),)
            found = self._worlds.contacts.rigid_contact_count
            self._gathers.append(
                lambda: self._launch(kernels.gather_pool, n_env, found, data.naconmax, 1 << _SOLVER_NCONMAX, self.bits)
            )

        def contacts(row: Any, stored: Any) -> None:
            self._launch(kernels.clear_counts, n_env, row, stored)
            self._launch(kernels.count_worlds, data.naconmax, row, data.nacon, data.contact.worldid, stored)

        def misplaced(row: Any, stored: Any) -> None:
            self._launch(kernels.clear_counts, n_env, row, stored)
            count_misplaced(self._worlds.solver.mjw_model, data, row, stored)

        self._counts = [
            (CONTACTS, contacts),
            (CONSTRAINT_ROWS, lambda row, stored: self._store(row, data.nefc, stored)),
            (SOLVER_ITERATIONS, lambda row, stored: self._store(row, data.solver_niter, stored)),
            (MISPLACED_CONTACTS, misplaced),
        ]

    def _store(self, row: Any, counts: Any, stored: Any) -> None:
        from gpusimbench.recorder.simulators.newton import kernels

        self._launch(kernels.store_counts, self._worlds.n_env, row, counts, stored)

    def _watch_pool(self, bit: int, name: str, *, counted: bool = True) -> None:
        """The buffer of Newton's collision detection: it counts on where it is full, and drops what comes then."""
        from gpusimbench.recorder.simulators.newton import kernels

        n_env, contacts = self._worlds.n_env, self._worlds.contacts
        capacity, found = contacts.rigid_contact_max, contacts.rigid_contact_count
        world_of = self._worlds.model.shape_world
        by = f"for each env {self._sizes.contacts_by}"
        self.overflow_bits += (OverflowBit(bit, name, fatal=True),)
        self.buffers += (Buffer("rigid_contact_max", capacity, "all", CONTACTS.name, by),)
        self._gathers.append(lambda: self._launch(kernels.gather_pool, n_env, found, capacity, 1 << bit, self.bits))

        def count(row: Any, stored: Any) -> None:
            shapes = contacts.rigid_contact_shape0, contacts.rigid_contact_shape1
            self._launch(kernels.clear_counts, n_env, row, stored)
            self._launch(kernels.count_shapes, capacity, row, found, *shapes, world_of, stored)

        if counted:
            self._counts.append((CONTACTS, count))

    def _watch_solver(self) -> None:
        """The buffers that the solver has besides."""
        from gpusimbench.recorder.simulators.newton import kernels

        worlds, solver, n_env = self._worlds, self._worlds.solver, self._worlds.n_env
        rows, by = self._sizes.rows, self._sizes.rows_by
        bit = 1 << _SOLVER_BUFFER
        match self._options.solver:
            case "steel":
                self.overflow_bits += (OverflowBit(_SOLVER_BUFFER, "constraint_overflow", fatal=True),)
                self.buffers += (Buffer("free_body_constraint_max", rows, "env", CONSTRAINT_ROWS.name, by),)
                flags = solver.constraint_overflow
                self._gathers.append(lambda: self._launch(kernels.gather_flags, n_env, flags, bit, self.bits))
                used = solver._mf_constraint_count  # Steel shows the number nowhere else
                self._counts.append((CONSTRAINT_ROWS, lambda row, stored: self._store(row, used, stored)))
            case "vbd":
                self.overflow_bits += (OverflowBit(_SOLVER_BUFFER, "BODY_CONTACTS", fatal=True),)
                self.buffers += (Buffer("rigid_body_contact_buffer_size", rows, "body", sized_by=by),)
                lengths, model = solver.body_body_contact_counts, worlds.model
                self._gathers.append(
                    lambda: self._launch(
                        kernels.gather_bodies, model.body_count, lengths, model.body_world, rows, bit, self.bits
                    )
                )
            case "kamino":
                self.overflow_bits += (OverflowBit(_SOLVER_BUFFER, "WORLD_CONTACTS", fatal=True),)
                sizes = self._sizes
                self.buffers += (Buffer("world_max_contacts", sizes.contacts, "env", CONTACTS.name, sizes.contacts_by),)
                warned = (
                    solver._contacts_kamino._data._contact_overflow_warning_emitted
                )  # Kamino's only trace of a loss
                self._gathers.append(lambda: self._launch(kernels.gather_pool, n_env, warned, 0, bit, self.bits))
