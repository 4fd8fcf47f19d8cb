"""Newton: its solvers in Warp kernels, on a GPU or, slowly, on the CPU.

On a GPU, blocks of steps and single steps are captured as CUDA graphs and replayed. A step reads one of two states and
writes the other, so a graph belongs to the state that it begins with. For a capture, further graphs store the state and
the counts of each step in a ring on the device, which is read once it is full.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, Ability
from gpusimbench.recorder.failure import Refused, cause_of
from gpusimbench.recorder.options import names_of, parse_options
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model.scene import ModelScene
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.evidence import Evidence, joined
from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions, replacement
from gpusimbench.recorder.simulators.newton.options import FOR_MODELS, MUJOCO_SOLVERS, NewtonOptions
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims, partial, picked
from gpusimbench.recorder.simulators.warp import runtime as warp_runtime
from gpusimbench.schemas.action_generator import Streams
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Deviation

_BLOCK = 10  # steps in a graph; even, so that it ends with the state that it began with
_RING_ROWS = 50
_RING_BYTES = 512 << 20

# of the solver (warp.DeterministicMode), and whether collision detection sorts its contacts
_LEVELS = {"default": ("off", False), "run-to-run": ("run-to-run", True), "gpu-to-gpu": ("gpu-to-gpu", True)}

_HIDDEN = {
    "steel": "warm-start impulses and friction anchors, which SolverSteel keeps to itself",
    "vbd": "duals and penalties, which SolverVBD keeps to itself",
    "kamino": "the warm start, which SolverKamino keeps to itself",
}
"""By solver, what decides the next step and cannot be saved."""


class Newton(Simulator):
    """N environments, the worlds of one newton.Model, all at the same place."""

    Options = NewtonOptions
    abilities = BODIES | {Ability.MODELS}
    timing_interval = _BLOCK
    draws_actions = True
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
        takes = options.solver in FOR_MODELS
        return {} if takes else {Ability.MODELS: f"solver={', '.join(FOR_MODELS[:-1])} or {FOR_MODELS[-1]}"}

    def build(self) -> Description:
        """See Simulator.build."""
        options: NewtonOptions = self.options
        level, self._ordered = _LEVELS[self.determinism]
        # Kamino has no determinism of its own: it gets Warp's, for all kernels
        self._device = warp_runtime.start(options.device, level if options.solver == "kamino" else "off")
        import newton
        import warp as wp

        from gpusimbench.recorder.simulators.mujoco.model import compile_scene
        from gpusimbench.recorder.simulators.newton.model import one_world
        from gpusimbench.recorder.simulators.newton.ring import Ring
        from gpusimbench.recorder.simulators.newton.sizes import choose_sizes
        from gpusimbench.recorder.simulators.newton.solvers import in_force, register
        from gpusimbench.recorder.simulators.newton.watch import Watch

        self._mode = wp.DeterministicMode[warp_runtime.MODES[level]]
        files = isinstance(self.scene, ModelScene)
        physics: MjcfOptions = parse_options("mujoco", MjcfOptions, self.scene.options({}, names_of(MjcfOptions)))
        if not files or options.solver == "mujoco":
            physics = replace(physics, cone=options.cone)
        compiled = compile_scene(self.scene, dt=self.dt, options=physics)
        self._sizes = choose_sizes(self.scene, dt=self.dt, seed=self.seed, options=options, physics=physics)
        with self._refusals():
            self._world = one_world(self.scene, compiled, options, register(options))
        self._compiled, self._physics = compiled, physics if files else None
        self._worlds = self._make_worlds(self.n_env)
        self._watch = Watch(self._worlds, options, self._sizes)
        self._last_step = Ring(self._worlds, self._watch, 1)  # for what is asked after `step`
        self._ring: Any = None
        self._graphs: dict[tuple[int, int, bool], Any] = {}
        self._kernels_built = False
        self._counted: Evidence | None = None
        self._made = 0  # steps since the build
        self._first = self._worlds.kept()
        pipeline = self._worlds.pipeline
        return Description(
            version=newton.__version__,
            device=warp_runtime.name_of(self._device),
            options=in_force(self._worlds.solver, options, files=files),
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
            attachments=compiled.attachments if files else {},
            buffers=self._watch.buffers,
            counters=self._watch.counters,
            overflow_bits=self._watch.overflow_bits,
            remarks=self._worlds.warnings,
        )

    def _deviations(self) -> tuple[Deviation, ...]:
        from gpusimbench.recorder.simulators.newton.deviations import deviations
        from gpusimbench.recorder.simulators.newton.made import deviations_of_import

        known = deviations(self.scene, self.options)
        if self._world.imported is None:
            return known
        built, solver = self._worlds.model, self._worlds.solver
        own = deviations_of_import(built, solver, self._world.imported, self._compiled.model, self.options.solver)
        return (*(() if self.options.solver == "mujoco" else known), *own)

    def _make_worlds(self, n_env: int) -> Any:
        from gpusimbench.recorder.simulators.newton.controls import ModelControls
        from gpusimbench.recorder.simulators.newton.worlds import Worlds

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
            how = f"replay of CUDA graphs of {_BLOCK} steps (fewer for what is left over) and one synchronisation"
        else:
            how = "collision detection and solver, step by step, on the CPU"
        drawn = "" if self.scene.actions is None else "; actions are drawn on the device"
        return f"{how}{drawn}; overflow bits are gathered on the device after each step; no state is copied"

    def compile(self, phase: str) -> None:
        """See Simulator.compile: kernels are built on one throw-away environment, then graphs are captured."""
        if not self._kernels_built:
            self._build_kernels()
        storing = phase == "capture"
        if storing and self._ring is None:
            from gpusimbench.recorder.simulators.newton.ring import Ring

            rows = max(1, min(_RING_ROWS, _RING_BYTES // Ring.row_bytes(self._worlds, self._watch)))
            self._ring = Ring(self._worlds, self._watch, rows)
        if self._device.is_cuda and (_BLOCK, 0, storing) not in self._graphs:
            parities = (0,) if self.options.substeps % 2 == 0 else (0, 1)
            for parity in parities:
                for n_step in (1, _BLOCK):
                    self._graphs[n_step, parity, storing] = self._captured(n_step, parity, storing)

    def _build_kernels(self) -> None:
        import warp as wp

        from gpusimbench.recorder.simulators.newton.ring import Ring
        from gpusimbench.recorder.simulators.newton.watch import Watch

        spare = self._make_worlds(1)
        watch = Watch(spare, self.options, self._sizes)
        ring = Ring(spare, watch, 2)
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

    def _captured(self, n_step: int, parity: int, storing: bool) -> Any:
        """A CUDA graph of steps that begins with the state of that parity; nothing is executed."""
        import warp as wp

        present = self._worlds.parity
        self._worlds.parity = parity
        with self._refusals(), wp.ScopedCapture(self._device) as capture:
            self._enqueue(n_step, storing)
        self._worlds.parity = present
        return capture.graph

    def _enqueue(self, n_step: int, storing: bool) -> None:
        for _ in range(n_step):
            self._worlds.act()
            for _ in range(self.options.substeps):
                self._worlds.substep()
                self._watch.gather()
            if storing:
                self._ring.store()

    def _advance(self, n_step: int, storing: bool) -> None:
        self._made += n_step
        if not self._device.is_cuda:
            self._enqueue(n_step, storing)
            return
        import warp as wp

        worlds = self._worlds
        while n_step:
            size = _BLOCK if n_step >= _BLOCK else 1
            wp.capture_launch(self._graphs[size, worlds.parity, storing])
            worlds.parity = (worlds.parity + size * self.options.substeps) % 2
            n_step -= size

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare: actions are drawn, or copied, on the device, by the streams as they are now."""
        if self._worlds.controls is not None:
            self._worlds.controls.drawn.follow(self.streams)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        import warp as wp

        if not self._kernels_built or (self._device.is_cuda and (_BLOCK, 0, False) not in self._graphs):
            self.compile("timed")
        self._counted = None
        self._advance(n_step, storing=False)
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
        from gpusimbench.recorder.simulators.newton.held import held

        places = self._world.imported
        if places is None:
            return None
        worlds, name = self._worlds, self.options.solver
        return held(worlds.model, worlds.solver, places, self._compiled.model, name=name, dt=self.dt)

    def link_poses(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See Simulator.link_poses: newton.eval_fk."""
        from gpusimbench.recorder.simulators.newton.held import link_poses

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

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        self.compile("capture")
        states, evidence = [], []
        for first in range(0, n_step, self._ring.rows):
            rows = min(self._ring.rows, n_step - first)
            self._ring.rewind()
            self._advance(rows, storing=True)
            states.append(self._world.layout.split(*self._ring.states(rows)))
            evidence.append(self._ring.evidence(rows))
        self._counted = joined(evidence)
        return states[0] if len(states) == 1 else tuple(map(np.concatenate, zip(*states, strict=True)))

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        if self._counted is None:
            self._last_step.rewind()
            self._last_step.store()
            return self._last_step.evidence(1)
        return self._counted

    def allocator_bytes(self) -> tuple[int, int] | None:
        """See Simulator.allocator_bytes."""
        return warp_runtime.allocator_bytes(self._device)

    def close(self) -> None:
        """See Simulator.close."""
        for name in ("_graphs", "_ring", "_last_step", "_watch", "_worlds"):
            vars(self).pop(name, None)
        gc.collect()
