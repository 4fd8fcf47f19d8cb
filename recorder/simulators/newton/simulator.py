"""Newton: its solvers in Warp kernels, on a GPU or, slowly, on the CPU.

On a GPU, blocks of steps and single steps are captured as CUDA graphs and replayed. A step reads one of two states and
writes the other, so a graph belongs to the state that it begins with. For a capture, further graphs store the state and
the counts of each step in rows on the device. The rows are those of a few slots; while one slot is filled, the one
before it is copied to the host.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS, Ability
from gpusimbench.recorder.failure import Refused, cause_of
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.captured import Captured
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.mujoco.options import own_options, replacement
from gpusimbench.recorder.simulators.newton.options import FOR_MODELS, MUJOCO_SOLVERS, NewtonOptions
from gpusimbench.recorder.simulators.newton.steps import BLOCK, Steps
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots, Slotted
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims, partial, picked
from gpusimbench.recorder.simulators.warp import runtime as warp_runtime
from gpusimbench.recorder.simulators.warp.transfer import WarpSlots
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Deviation

_SLOT_ROWS = 50
_SLOT_BYTES = 256 << 20  # the recorder asks for blocks of at most 128 MiB of states; counts come on top

# of the solver (warp.DeterministicMode), and whether collision detection sorts its contacts
_LEVELS = {"default": ("off", False), "run-to-run": ("run-to-run", True), "gpu-to-gpu": ("gpu-to-gpu", True)}

_BY_MJCF = ROBOTS | {Ability.CHAINS, Ability.MODELS}
"""What comes through Newton's importer of MJCF, which takes a pin between two sites for one at the first of them."""

_HIDDEN = {
    "steel": "warm-start impulses and friction anchors, which SolverSteel keeps to itself",
    "vbd": "duals and penalties, which SolverVBD keeps to itself",
    "kamino": "the warm start, which SolverKamino keeps to itself",
}
"""By solver, what decides the next step and cannot be saved."""


class Newton(Slotted):
    """N environments, the worlds of one newton.Model, all at the same place."""

    Options = NewtonOptions
    distribution = "newton"
    abilities = BODIES | _BY_MJCF
    timing_interval = BLOCK
    draws_actions = True
    blocks_ahead = 2
    determinism_levels = {
        "default": "as it ships: contacts, and what solvers add up by atomic operations, in the order in which the "
        "device's threads arrive",
        "run-to-run": "the solver orders its atomic operations (steel: its rows of constraints) and CollisionPipeline "
        "sorts its contacts: the same bits again on the same kind of GPU, with the same driver and Warp",
        "gpu-to-gpu": "as run-to-run, with Warp's stricter order of atomic operations, meant to hold for every GPU",
    }

    @classmethod
    def parsed(cls, name: str, scene: Scene, given: Mapping[str, str]) -> Any:
        """See Simulator.parsed: solver mujoco is set as a model says, and 'solver' in MJCF is not Newton's."""
        own = dict(scene.options({}, ("cone", "iterations", "solver")))
        solver = given.get("solver", NewtonOptions.solver)
        if own and solver in MUJOCO_SOLVERS:
            given = {"cone": own["cone"], "iterations": own["iterations"], **given}
        elif own and solver == "mujoco":
            given = {"cone": own["cone"], "iterations": own["iterations"], "mujoco_solver": own["solver"], **given}
            if given["mujoco_solver"] not in MUJOCO_SOLVERS and given["mujoco_solver"] == own["solver"]:
                said = f"simulator '{name}' with solver=mujoco does not take {scene.name}: mjSOL_{own['solver']}"
                raise UsageError(f"{said}{replacement(said)}")
        return parse_options(name, cls.Options, given)

    @classmethod
    def withheld(cls, options: Any) -> dict[Ability, str]:
        """See Simulator.withheld."""
        if options.solver == "mujoco":
            return {}
        if options.solver in FOR_MODELS:
            return {Ability.ACTIONS: "solver=mujoco"}  # servos of the others have no limit of force
        return dict.fromkeys(_BY_MJCF, f"solver={', '.join(FOR_MODELS[:-1])} or {FOR_MODELS[-1]}")

    def build(self) -> Description:
        """See Simulator.build."""
        options: NewtonOptions = self.options
        level, self._ordered = _LEVELS[self.determinism]
        # Kamino has no determinism of its own: it gets Warp's, for all kernels
        self._device = warp_runtime.start(options.device, level if options.solver == "kamino" else "off")
        import newton
        import warp as wp

        from gpusimbench.recorder.simulators.mujoco.model import compile_scene
        from gpusimbench.recorder.simulators.newton.model import comes_as_mjcf, one_world
        from gpusimbench.recorder.simulators.newton.ring import Ring, evidence_shapes
        from gpusimbench.recorder.simulators.newton.solvers import in_force, register
        from gpusimbench.recorder.simulators.newton.watch import Watch, choose_sizes

        self._mode = wp.DeterministicMode[warp_runtime.MODES[level]]
        mjcf = comes_as_mjcf(self.scene)
        physics = own_options(self.scene)
        if not mjcf or options.solver == "mujoco":
            physics = replace(physics, cone=options.cone)
        compiled = compile_scene(self.scene, dt=self.dt, options=physics)
        self._sizes = choose_sizes(self.scene, dt=self.dt, seed=self.seed, options=options, physics=physics)
        with self._refusals():
            self._world = one_world(self.scene, compiled, options, register(options))
        self._compiled, self._physics = compiled, physics if mjcf else None
        self._worlds = self._make_worlds(self.n_env)
        self._watch = Watch(self._worlds, options, self._sizes)
        self._last_counts = _allocated(evidence_shapes(self._watch, self.n_env, 1))  # for what is asked after `step`
        self._last_step = Ring(self._worlds, self._watch, self._last_counts)
        self._ring: Any = None
        self._timed: Steps | None = None
        self._storing: Steps | None = None  # those that fill rows of slots
        self._kernels_built = False
        self._made = 0  # steps since the build
        self._first = self._worlds.kept()
        pipeline = self._worlds.pipeline
        return Description(
            version=newton.__version__,
            device=warp_runtime.name_of(self._device),
            options=in_force(self._worlds.solver, options, mjcf=mjcf),
            switches={
                "precision": "float32",
                "solver": options.solver,
                "determinism": self.determinism,
                "solver_deterministic": self._mode.name,
                "warp.config.deterministic": wp.config.deterministic.name,
                "contacts": "MuJoCo Warp" if pipeline is None else f"CollisionPipeline, {pipeline.broad_phase_mode}",
                "contacts_sorted": pipeline is not None and pipeline.deterministic,
                "warp": wp.config.version,
            },
            deviations=self._deviations(),
            fields=self._world.layout.fields(),
            timing_covers=self._covers(),
            attachments=compiled.attachments if mjcf else {},
            buffers=self._watch.buffers,
            counters=self._watch.counters,
            overflow_bits=self._watch.overflow_bits,
            remarks=self._worlds.remarks,
        )

    def _deviations(self) -> tuple[Deviation, ...]:
        from gpusimbench.recorder.simulators.mujoco.model import raised_tolerance
        from gpusimbench.recorder.simulators.newton.deviations import deviations, deviations_of_import

        built, solver = self._worlds.model, self._worlds.solver
        raised: tuple[Deviation, ...] = ()
        if self.options.solver == "mujoco":
            held = float(solver.mjw_model.opt.tolerance.numpy()[0])
            raised = raised_tolerance(solver.mj_model.opt.tolerance, held)
        known = deviations(self.scene, self.options)
        if self._world.imported is None:
            return (*known, *raised)
        own = deviations_of_import(
            built, solver, self._world.imported, self._compiled.model, self.options.solver,
            of_file=isinstance(self.scene, ModelScene),
        )  # fmt: skip
        if self.options.own_contacts:  # the option 'gap' is every shape's, and is recorded as an option
            own = [deviation for deviation in own if not deviation.parameter.endswith(".gap")]
        of_contacts = self._compiled.deviations if self.options.solver == "mujoco" else known
        return (*of_contacts, *own, *raised)

    def _make_worlds(self, n_env: int) -> Any:
        from gpusimbench.recorder.simulators.newton.worlds import ModelControls, Worlds

        with self._refusals():
            worlds = Worlds(
                self._world, n_env=n_env, dt=self.dt, options=self.options, physics=self._physics,
                sizes=self._sizes, mode=self._mode, ordered=self._ordered,
            )  # fmt: skip
        if self.scene.actions is not None and self._world.imported is not None:
            worlds.controls = ModelControls(
                self.scene, self.seed, self.streams if n_env == self.n_env else Streams.usual(n_env),
                self._world.imported, self._compiled.model, worlds.control, self.options, n_env,
            )  # fmt: skip
        return worlds

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        # what the engine does not do under a level of determinism is an outcome, not a crash
        try:
            yield
        except (RuntimeError, ValueError, NotImplementedError) as error:
            if cause_of(error) == "DEVICE_MEMORY":
                raise
            text, solver = " ".join(str(error).split()), f"Newton's solver '{self.options.solver}'"
            if self.determinism != "default":
                raise Refused(f"{solver} refuses determinism '{self.determinism}': {text}") from None
            if not isinstance(self.scene, ModelScene):
                raise
            raise Refused(f"{solver} does not take {self.scene.file}: {text}") from None

    def _covers(self) -> str:
        if self._device.is_cuda:
            how = f"replay of CUDA graphs of {BLOCK} steps (fewer for what is left over) and one synchronisation"
        else:
            how = "collision detection and solver, step by step, on the CPU"
        drawn = "" if self.scene.actions is None else "; actions are drawn on the device"
        return f"{how}{drawn}; overflow bits are gathered on the device after each step; no state is copied"

    def compile(self, phase: str) -> None:
        """See Simulator.compile: kernels are built on one throw-away environment, then graphs are captured; those of a
        capture with their slots, whose size is known when states are asked for."""
        if not self._kernels_built:
            self._build_kernels()
        if phase == "timed" and self._timed is None:
            self._timed = self._steps()

    def reserve(self, n_step: int) -> None:
        """See Simulator.reserve; longer blocks are made in parts."""
        self.compile("capture")
        if self._slots is not None and self._slots.rows >= n_step:
            return
        from gpusimbench.recorder.simulators.newton.ring import Ring, evidence_shapes, row_bytes, state_shapes

        worlds, watch = self._worlds, self._watch
        rows = max(1, min(n_step, _SLOT_ROWS, _SLOT_BYTES // row_bytes(worlds, watch)))
        if self._slots is None or self._slots.rows < rows:
            shapes = state_shapes(worlds, rows) | evidence_shapes(watch, self.n_env, rows)
            self._slots = WarpSlots(self._device, shapes)
            self._ring = Ring(worlds, watch, self._slots.arrays)
            self._storing = self._steps(self._ring)

    def _steps(self, ring: Any = None) -> Steps:
        return Steps(
            self._worlds, self._watch, ring,
            substeps=self.options.substeps, device=self._device, refusals=self._refusals,
        )  # fmt: skip

    def _build_kernels(self) -> None:
        import warp as wp

        from gpusimbench.recorder.simulators.newton.ring import Ring, evidence_shapes, state_shapes
        from gpusimbench.recorder.simulators.newton.watch import Watch

        spare = self._make_worlds(1)
        watch = Watch(spare, self.options, self._sizes)
        ring = Ring(spare, watch, _allocated(state_shapes(spare, 2) | evidence_shapes(watch, 1, 2)))
        with self._refusals():
            for _ in range(2):
                spare.act()
                spare.substep()
                watch.gather()
                ring.store()
            wp.synchronize_device(self._device)
        del spare, watch, ring
        gc.collect()  # solvers and their watch are in cycles, which hold on to device memory
        self._kernels_built = True

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare: actions are drawn, or copied, on the device, by the streams as they are now."""
        if self._worlds.controls is not None:
            self._worlds.controls.drawn.follow(self.streams)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        import warp as wp

        self.compile("timed")
        assert self._timed is not None
        self._made += n_step
        self._counted = None
        self._timed.enqueue(n_step)
        wp.synchronize_device(self._device)

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        hidden = _HIDDEN.get(options.solver)
        saved = partial(hidden) if hidden else COMPLETE
        return StateClaims(saved, saved, COMPLETE, COMPLETE)

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        return Snapshot(self._made, self._worlds.kept())

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        self._put(snapshot.arrays, envs)
        if envs is None:
            self._go_to(snapshot.step)

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: the solver's own reset of these worlds, and the first poses and speeds."""
        self._put(self._first, envs)
        if envs is None:
            self._go_to(0)

    def _go_to(self, step: int) -> None:
        self._made = step
        if self._worlds.controls is not None:
            self._worlds.controls.drawn.step.fill_(step)

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        controls = self._worlds.controls
        return None if controls is None else np.array(controls.ctrl.numpy())

    def _put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs) -> None:
        self._worlds.put(picked(arrays, envs), envs)
        self._counted = None

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state: as reset, then positions and velocities."""
        self.reset(envs)
        self._worlds.place(*self._world.layout.joined(states), envs)

    def state(self) -> States:
        """See Simulator.state."""
        arrays = (array.numpy().reshape(1, self.n_env, -1) for array in self._worlds.shown())
        return tuple(array[0] for array in self._world.layout.split(*arrays))

    def imported(self) -> Imported | None:
        """See Simulator.imported."""
        from gpusimbench.recorder.simulators.newton.held_parameters import held_parameters

        places = self._world.imported
        if places is None:
            return None
        worlds, name = self._worlds, self.options.solver
        return held_parameters(worlds.model, worlds.solver, places, self._compiled.model, name=name, dt=self.dt)

    def link_poses(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See Simulator.link_poses: newton.eval_fk."""
        from gpusimbench.recorder.simulators.newton.held_parameters import link_poses

        known, places = self.imported(), self._world.imported
        assert known is not None and places is not None
        poses = self._worlds.state.body_q.numpy().reshape(self.n_env, -1, 7)
        return link_poses(poses, places, self._compiled.model, known.names)

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold: with solver mujoco."""
        given = getattr(self._worlds.control, "mujoco", None) if self.options.solver == "mujoco" else None
        if given is None or given.ctrl.size != controls.size:
            raise NotImplementedError
        given.ctrl.assign(controls.astype(np.float32).ravel())

    def _fill(self, slots: Slots, slot: Slot, n_step: int) -> Captured:
        from gpusimbench.recorder.simulators.newton.ring import evidence_of, states_of

        assert self._storing is not None
        self._ring.go_to(slot.first)
        self._made += n_step
        self._counted = None
        self._storing.enqueue(n_step)
        slots.begin_copy(slot, n_step)
        layout, counters = self._world.layout, self._watch.counters
        return SlotBlock(
            slots, slot, n_step,
            split=lambda host, envs: states_of(layout, self.n_env, host, envs),
            told=lambda host: evidence_of(counters, host),
        )  # fmt: skip

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        if self._counted is None:
            from gpusimbench.recorder.simulators.newton.ring import evidence_of

            self._last_step.store_evidence()
            return evidence_of(self._watch.counters, lambda name: np.array(self._last_counts[name].numpy()))
        return self._counted

    def allocator_bytes(self) -> tuple[int, int] | None:
        """See Simulator.allocator_bytes."""
        return warp_runtime.allocator_bytes(self._device)

    def close(self) -> None:
        """See Simulator.close."""
        for name in ("_timed", "_storing", "_ring", "_slots", "_last_step", "_last_counts", "_watch", "_worlds"):
            vars(self).pop(name, None)
        gc.collect()


def _allocated(shapes: Mapping[str, tuple[tuple[int, ...], Any]]) -> dict[str, Any]:
    """Arrays on Warp's present device, of shape and dtype by name."""
    import warp as wp

    return {name: wp.empty(shape, dtype=dtype) for name, (shape, dtype) in shapes.items()}
