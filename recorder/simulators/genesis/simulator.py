"""Genesis: its rigid solver, in kernels that Quadrants compiles, on a GPU or, on one thread, on the CPU.

Environments are the batch of one genesis.Scene, all at the same place. A process has one Genesis at a time: build
initialises it, close destroys it. For a capture, states and counts of each step are copied into rows of tensors on the
device. The rows are those of a few slots; while one slot is filled, the one before it is copied to the host.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS, Ability
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.options import names_of, parse_options
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.base import Description, States
from gpusimbench.recorder.simulators.captured import Captured
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.genesis import runtime
from gpusimbench.recorder.simulators.genesis.options import GenesisOptions
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots, Slotted
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Deviation

if TYPE_CHECKING:
    from gpusimbench.recorder.simulators.genesis.environments import GenesisSizes

_SLOT_ROWS = 50
_SLOT_BYTES = 256 << 20  # the recorder asks for blocks of at most 128 MiB of states; counts come on top

_NEAREST = {"integrator": {"RK4": "Euler", "implicit": "implicitfast"}, "solver": {"PGS": "Newton"}}
"""Words of a model for options that Genesis has no such word for, and what is used instead."""

_LEVELS = {"default": None, "off": False, "run-to-run": True}  # use_deterministic_algorithms

_SOLVER_OPTIONS = (
    "integrator", "constraint_solver", "iterations", "ls_iterations", "ls_tolerance", "tolerance", "noslip_iterations",
    "friction_cone", "impratio", "contact_resolution", "constraint_timeconst", "contact_pruning_tolerance",
    "enable_multi_contact", "enable_neutral_collision", "use_gjk_collision", "box_box_detection",
    "enable_mujoco_compatibility", "use_hibernation", "max_collision_pairs", "max_contacts",
    "multiplier_collision_broad_phase",
)  # fmt: skip


class Genesis(Slotted):
    """N environments on Genesis."""

    Options = GenesisOptions
    distribution = "genesis-world"
    abilities = BODIES - {Ability.CAPSULES} | ROBOTS | {Ability.CHAINS, Ability.LOOPS, Ability.MODELS}
    timing_interval = 10  # Genesis itself waits for the device at every tenth substep, to look at its error codes
    blocks_ahead = 2
    levels_without_effect = {
        "cpu": dict.fromkeys(("off", "run-to-run"), "on a CPU there is one implementation, and nothing to choose")
    }
    determinism_levels = {
        "default": "as it ships: use_deterministic_algorithms is left to the engine, which sets it unless "
        "performance_mode is on",
        "off": "use_deterministic_algorithms off: on a GPU the solver's implementation may be chosen by timing, while "
        "it runs",
        "run-to-run": "use_deterministic_algorithms on: implementations are chosen at build, for the same bits on the "
        "same hardware",
    }

    @classmethod
    def parsed(cls, name: str, scene: Scene, given: Mapping[str, str]) -> Any:
        """See Simulator.parsed: where the user says nothing, a model's own options, as far as Genesis has them.

        The tolerance is the engine's at single precision, which does not come to MuJoCo's.
        """
        given = {option: value for option, value in given.items() if option not in scene.own_options}
        if isinstance(scene, ModelScene):
            own = scene.options({}, names_of(cls.Options))
            if given.get("precision", "32") != "64":
                own.pop("tolerance", None)
            nearest = {option: _NEAREST.get(option, {}).get(word, word) for option, word in own.items()}
            given = {**nearest, "contact_resolution": "convex", **given}
        return parse_options(name, cls.Options, given)

    def build(self) -> Description:
        """See Simulator.build."""
        options: GenesisOptions = self.options
        compiled = self._compiled(options)
        genesis = self._genesis = runtime.start(options, deterministic=_LEVELS[self.determinism], seed=self.seed)
        from gpusimbench.recorder.simulators.genesis.deviations import deviations
        from gpusimbench.recorder.simulators.genesis.keep import Keep
        from gpusimbench.recorder.simulators.genesis.ring import Rows
        from gpusimbench.recorder.simulators.genesis.watch import COUNTERS, Watch, buffers

        with self._refusals():
            sizes = self._make(compiled, options)
        of_model = self._read(options)
        self._watch = Watch(self._model.solver)
        self._keep = Keep(self._model.solver)
        self._done = 0  # steps since the build, or since all were brought back
        self._given = False  # whether states were given that a reset does not bring back
        self._rows = Rows(self._model, self._watch)
        self._last = self._rows.tensors(1)
        self._drives: Sequence[Any] = ()
        self._next_drive = 0
        return Description(
            version=genesis.__version__,
            device=runtime.device_name(genesis),
            options=self._in_force(),
            switches=self._switches(),
            deviations=(*deviations(self.scene, options), *of_model),
            fields=self._model.fields(f"float{options.precision}"),
            timing_covers=self._covers(),
            attachments=self._model.attachments(),
            buffers=buffers(self._model.solver, sizes),
            counters=COUNTERS,
            overflow_bits=self._watch.overflow_bits,
        )

    def _compiled(self, options: GenesisOptions) -> Any:
        """The scene as MuJoCo compiles it; a model file is refused here, before the engine starts."""
        from gpusimbench.recorder.simulators.mujoco.model import compile_scene
        from gpusimbench.recorder.simulators.mujoco.options import MjcfOptions

        if isinstance(self.scene, ModelScene):
            from gpusimbench.recorder.simulators.genesis.imported import compile_model

            return compile_model(self.scene, dt=self.dt)
        return compile_scene(self.scene, dt=self.dt, options=MjcfOptions(cone=options.cone))

    def _make(self, compiled: Any, options: GenesisOptions) -> GenesisSizes:
        """Build the environments; how much room their contacts have."""
        from gpusimbench.recorder.simulators.genesis.environments import choose_sizes

        sizes = choose_sizes(compiled, dt=self.dt, seed=self.seed, options=options)
        common: dict[str, Any] = {"n_env": self.n_env, "dt": self.dt, "options": options, "sizes": sizes}
        self._model: Any
        if isinstance(self.scene, ModelScene):
            from gpusimbench.recorder.simulators.genesis.imported import build_model

            self._model = build_model(self._genesis, compiled, **common)
        else:
            from gpusimbench.recorder.simulators.genesis.model import build_scene

            self._model = build_scene(self._genesis, self.scene, **common)
        return sizes

    def _read(self, options: GenesisOptions) -> list[Deviation]:
        """What Genesis made of a model file otherwise than MuJoCo."""
        self._imported: Imported | None = None
        if not isinstance(self.scene, ModelScene):
            return []
        from gpusimbench.recorder.simulators.genesis.deviations import deviations_of_model
        from gpusimbench.recorder.simulators.genesis.held_parameters import held_parameters

        self._imported = held_parameters(self._model, dt=self.dt)
        return deviations_of_model(self._model, self._imported, options)

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        # ValueError is what its options raise, GenesisException what its solver does
        try:
            yield
        except (self._genesis.GenesisException, ValueError) as error:
            text = " ".join(str(error).split())
            raise Refused(f"Genesis does not accept this scene with these options: {text}") from None

    def _in_force(self) -> dict[str, Any]:
        options: GenesisOptions = self.options
        of_solver = self._model.scene.options.rigid
        return {
            "substeps": options.substeps,
            "performance_mode": options.performance_mode,
            **{name: _plain(getattr(of_solver, name)) for name in _SOLVER_OPTIONS},
            # Genesis takes two substeps at least
            "constraint_timeconst": float(self._model.solver._sol_default_timeconst),
        }

    def _switches(self) -> dict[str, Any]:
        chosen = self._model.solver.rigid_config
        return {
            **runtime.switches(self._genesis),
            "determinism": self.determinism,
            **{
                name: _plain(getattr(chosen, name))
                for name in ("prefer_decomposed_solver", "sparse_solve", "broadphase_traversal", "para_level")
            },
        }

    def _covers(self) -> str:
        what = "Scene.step of all environments, with the engine's look at its error codes at every tenth substep"
        if self.scene.actions is not None:
            what += "; before each, forces or targets of joints, which lie on the device"
        return f"{what}; one synchronisation with the device; no state is copied, nothing is drawn"

    def compile(self, phase: str) -> None:
        """See Simulator.compile: some kernels are loaded at the first step only; the state is brought back."""
        before = self._keep.kept() if self._given else None  # large: not where a reset does
        self._model.scene.step(update_visualizer=False)
        if phase == "capture":
            self._rows.store_state(self._last, 0)
            self._rows.store_evidence(self._last, 0)
        self._model.reset()
        if before is not None:
            self._keep.put(before, None)
        runtime.synchronise(self._genesis)

    def reserve(self, n_step: int) -> None:
        """See Simulator.reserve; longer blocks are made in parts."""
        rows = max(1, min(n_step, _SLOT_ROWS, _SLOT_BYTES // self._rows.row_bytes()))
        if self._slots is None or self._slots.rows < rows:
            from gpusimbench.recorder.simulators.genesis.ring import TorchSlots

            self._slots = TorchSlots(self._genesis.device, self._rows.shapes(rows))

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""
        self._drives = () if actions is None else self._model.drives(actions)
        self._next_drive = 0

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        found: NDArray[np.float32] | None = self._model.applied()
        return found

    def imported(self) -> Imported | None:
        """See Simulator.imported: arrays of the rigid solver."""
        return self._imported

    def link_poses(self) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """See Simulator.link_poses: where Genesis has the links."""
        positions, orientations = self._model.link_poses()
        return positions, orientations

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold."""
        self._model.hold(controls)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        for _ in range(n_step):
            self._advance()
        runtime.synchronise(self._genesis)

    def _advance(self) -> None:
        self._done += 1
        self._counted = None
        for drive in self._drives:
            drive.give(self._next_drive)
        self._next_drive += 1
        try:
            self._model.scene.step(update_visualizer=False)
        except self._genesis.GenesisException:
            # raised before the step, for what an earlier one left in the engine's error codes
            if not self._watch.take():
                raise
            self._model.scene.step(update_visualizer=False)

    def state(self) -> States:
        """See Simulator.state."""
        self._rows.store_state(self._last, 0)
        return tuple(array[0] for array in self._rows.split(self._last_on_host, slice(None)))

    def _last_on_host(self, name: str) -> NDArray[Any]:
        # a copy, also where the device is the host
        return np.array(self._last[name].cpu().numpy())

    def _fill(self, slots: Slots, slot: Slot, n_step: int) -> Captured:
        """See Slotted: Genesis looks at its error codes at every tenth substep, and waits then."""
        for row in range(n_step):
            self._advance()
            self._rows.store_state(slot.arrays, row)
            self._rows.store_evidence(slot.arrays, row)
        slots.begin_copy(slot, n_step)
        return SlotBlock(slots, slot, n_step, split=self._rows.split, told=self._rows.evidence)

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        return StateClaims(COMPLETE, COMPLETE, COMPLETE, COMPLETE)

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot: what Genesis' checkpoints hold of what steps change."""
        return Snapshot(self._done, self._keep.kept())

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        self._keep.put(snapshot.arrays, envs)
        self._counted, self._given = None, True
        if envs is None:
            self._done = snapshot.step

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: Scene.reset, and the speeds and angles that it does not know."""
        self._watch.take()  # the engine forgets its error codes here
        self._model.reset(envs)
        self._counted = None
        if envs is None:
            self._done = 0

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state."""
        self.reset(envs)
        self._given = True
        self._model.give(states, envs)

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        if self._counted is None:
            self._rows.store_evidence(self._last, 0)
            return self._rows.evidence(self._last_on_host)
        return self._counted

    def gates(self) -> list[str]:
        """See Simulator.gates: the engine's own words for whatever it would have stopped at."""
        return self._watch.gates()

    def close(self) -> None:
        """See Simulator.close."""
        # tensors that share the engine's memory go before it does
        for name in ("_drives", "_slots", "_rows", "_last", "_keep", "_watch", "_model", "_counted"):
            vars(self).pop(name, None)
        runtime.stop()


def _plain(value: Any) -> Any:
    return getattr(value, "name", value)  # of enumerations the name
