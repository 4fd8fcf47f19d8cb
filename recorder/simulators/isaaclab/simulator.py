"""Isaac Lab: its InteractiveScene and SimulationContext, without a window, on PhysX or on Newton.

Environments are clones that lie beside each other in one world, on a grid about its origin; states are recorded in that
world's frame, and the environments' origins with them. For a capture, the state of each step is kept on the device; a
full block is copied to the host while the next is made.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import metadata
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, Ability
from gpusimbench.recorder.failure import Refused, cause_of
from gpusimbench.recorder.options import names_of, parse_options
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.captured import Captured, States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.isaaclab.options import IsaacLabOptions
from gpusimbench.recorder.simulators.physx.options import OF_MODELS
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots, Slotted
from gpusimbench.recorder.simulators.snapshot import COMPLETE, Envs, Snapshot, StateClaims, partial, picked
from gpusimbench.recorder.simulators.warp import runtime as warp_runtime
from gpusimbench.recorder.simulators.warp.transfer import WarpSlots
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Deviation

_OLDEST = 3  # before it, quaternions were wxyz, and nothing ran without Isaac Sim
_ROWS = 50
_STATES = ("positions", "velocities")  # the arrays of a slot, in the order of World.state
_ROW_BYTES = 128 << 20  # of all rows
_POSES, _SPEEDS = "body_link_pose_w", "body_com_vel_w"
_BODY = 4 * (7 + 6)  # bytes of a body's pose and speeds

_LEVELS = {
    "ovphysx": ("default", "enhanced"),
    "physx": ("default", "enhanced"),
    "newton": ("default", "run-to-run", "gpu-to-gpu"),
}

_CONTACTS = partial(
    "what PhysX keeps to itself of contacts, such as impulses, friction and the order of their solution, and of a "
    "model file the last bits of the pose of a body on a free joint"
)
_CLAIMS = {
    "newton": StateClaims(COMPLETE, COMPLETE, COMPLETE, COMPLETE),
    "ovphysx": StateClaims(_CONTACTS, _CONTACTS, _CONTACTS, _CONTACTS),
}
"""By backend; of what runs within Isaac Sim nothing is known."""


class IsaacLab(Slotted):
    """N environments of an InteractiveScene."""

    Options = IsaacLabOptions
    distribution = "isaaclab"
    abilities = BODIES - {Ability.TILTED_PLANES} | {Ability.MODELS}  # environments beside each other share a plane
    blocks_ahead = 2
    timing_interval = 10  # Newton's steps are queued; synchronising after each would be charged to it
    determinism_levels = {
        "default": "as it ships, on any backend",
        "enhanced": "backends ovphysx and physx: PhysX's enhanced determinism, with which what happens in one place "
        "does not depend on what else is in the scene",
        "run-to-run": "backend newton: the solver orders its atomic operations: the same bits again on the same kind "
        "of GPU, with the same driver and Warp",
        "gpu-to-gpu": "backend newton: as run-to-run, with Warp's stricter order of atomic operations, meant to hold "
        "for every GPU",
    }

    @classmethod
    def parsed(cls, name: str, scene: Scene, given: Mapping[str, str]) -> Any:
        """See Simulator.parsed: of a model's pair of geoms, friction is the larger one, as it is in MuJoCo, and the
        solver's options are those of the file."""
        given = {option: value for option, value in given.items() if option not in scene.own_options}
        if isinstance(scene, ModelScene):
            given = {**OF_MODELS, **scene.options(given, names_of(cls.Options))}
        return parse_options(name, cls.Options, given)

    @classmethod
    def withheld(cls, options: Any) -> dict[Ability, str]:
        """See Simulator.withheld."""
        return {Ability.MODELS: "backend=ovphysx"} if options.backend == "physx" else {}

    def build(self) -> Description:
        """See Simulator.build."""
        options: IsaacLabOptions = self.options
        if self.determinism not in _LEVELS[options.backend]:
            raise UsageError(
                f"backend '{options.backend}' of simulator 'isaaclab' has no determinism '{self.determinism}'; "
                f"it has: {', '.join(_LEVELS[options.backend])}"
            )
        version = metadata.version("isaaclab")
        if int(version.partition(".")[0]) < _OLDEST:
            raise UsageError(f"simulator 'isaaclab' is for Isaac Lab {_OLDEST} and later; installed is {version}")
        if options.backend == "ovphysx" and find_spec("ovphysx") is None:
            raise UsageError("backend 'ovphysx' of simulator 'isaaclab' needs ovphysx, which is not installed")
        if options.backend == "physx":
            from gpusimbench.recorder.simulators.isaaclab.physx import start_isaac_sim

            start_isaac_sim()
        self._device = warp_runtime.start(options.device)
        _without_pinned_memory()
        self._stepped = True  # what the last step showed has still to be asked for
        self._compiled = False
        self._model: Any = None  # of a model file
        if isinstance(self.scene, ModelScene):
            self._model = self._make_model(self.scene)
        self._physics = self._make_physics()
        self._world = self._make_world()
        self._physics.attach(self._world.sim, self._rows())
        if self._model is not None and self.options.backend == "newton":
            self._model.read(self._world.sim.physics_manager)
        self._made = 0  # steps
        self._first = self._kept()
        origins = tuple((float(x), float(y), float(z)) for x, y, z in self._world.origins.tolist())
        return Description(
            version=version,
            device=warp_runtime.name_of(self._device),
            options={**dict.fromkeys(self._option_names()), **self._common(), **self._physics.in_force()},
            switches={
                "precision": "float32",
                "backend": options.backend,
                "determinism": self.determinism,
                "spacing": options.spacing,
                **self._physics.switches(),
            },
            deviations=self._deviations(),
            fields=self._world.fields(),
            timing_covers=self._covers(),
            attachments={
                "scene.usda": ("model/vnd.usda", self._world.usda()),
                **(self._model.compiled.attachments if self._model else {}),
            },
            env_origins=origins if any(any(origin) for origin in origins) else (),
            buffers=self._physics.buffers,
            counters=self._physics.counters,
            overflow_bits=self._physics.overflow_bits,
            remarks=(*self._world.warnings, *self._physics.remarks()),
        )

    def _make_model(self, scene: ModelScene) -> Any:
        if self.options.backend == "newton":
            from gpusimbench.recorder.simulators.isaaclab.newton_model import NewtonModel

            return NewtonModel(scene, dt=self.dt)
        from gpusimbench.recorder.simulators.physx.model import Model

        return Model(scene, dt=self.dt)

    def _deviations(self) -> tuple[Deviation, ...]:
        from gpusimbench.recorder.simulators.isaaclab.deviations import deviations

        found = deviations(self.scene, self.options)
        of_solver = self._physics.deviations()
        if self._model is None:
            return (*found, *of_solver)
        from gpusimbench.recorder.simulators.isaaclab.model import as_physx

        return (*found, *self._model.deviations(as_physx(self.options), gpu=self._device.is_cuda), *of_solver)

    def _option_names(self) -> tuple[str, ...]:
        sizes = ("max_contacts", "max_rows")  # said with the buffers
        return tuple(name for name in IsaacLabOptions.__dataclass_fields__ if name not in sizes)

    def _common(self) -> dict[str, Any]:
        options: IsaacLabOptions = self.options
        names = ["backend", "spacing"]
        if options.backend != "newton" or self._model is None:  # to Newton, distances of contacts are the file's
            names += ["contact_offset", "rest_offset"]
        return {**{name: getattr(options, name) for name in names}, "device": str(self._device)}

    def _make_physics(self) -> Any:
        common: dict[str, Any] = {
            "n_env": self.n_env, "dt": self.dt, "seed": self.seed, "options": self.options, "level": self.determinism
        }  # fmt: skip
        if self.options.backend == "newton":
            from gpusimbench.recorder.simulators.isaaclab.newton import Newton

            return Newton(self.scene, **common)
        from gpusimbench.recorder.simulators.isaaclab.physx import Physx

        return Physx(self.scene, gpu=self._device.is_cuda, **common)

    def _make_world(self) -> Any:
        from gpusimbench.recorder.simulators.isaaclab.model import ModelWorld
        from gpusimbench.recorder.simulators.isaaclab.world import BodyWorld

        common: dict[str, Any] = {
            "n_env": self.n_env, "dt": self.dt, "options": self.options, "device": str(self._device)
        }  # fmt: skip
        try:
            if self._model is not None:
                return ModelWorld(self._model, self._physics, **common)
            return BodyWorld(self.scene, self._physics, **common)
        except (RuntimeError, ValueError, NotImplementedError) as error:
            raise self._refused(error) from None

    def _refused(self, error: Exception) -> Exception:
        """What the engine does not do under a level of determinism is an outcome, not a crash."""
        if self.determinism == "default" or cause_of(error) == "DEVICE_MEMORY":
            return error
        text = " ".join(str(error).split())
        return Refused(f"Isaac Lab's backend '{self.options.backend}' refuses '{self.determinism}': {text}")

    def _rows(self) -> int:
        size = _BODY * self.n_env * len(self.scene.moving())
        if self._model is not None:
            size = 4 * self.n_env * (self._model.compiled.model.nq + self._model.compiled.model.nv)
        return max(1, min(_ROWS, _ROW_BYTES // size))

    def _covers(self) -> str:
        loop = "SimulationContext.step(render=False) and RigidObjectCollection.update, step by step"
        if self._model is not None:
            loop = (
                "Articulation.write_data_to_sim, with controls that are on the device, SimulationContext.step("
                "render=False) and Articulation.update, step by step"
            )
        end = "one synchronisation at the end; " if self._device.is_cuda else ""
        return f"{loop}; the latter derives accelerations, on the device; {end}no state is copied to the host"

    def compile(self, phase: str) -> None:
        """See Simulator.compile: Newton builds its kernels in its first step, which is then taken back."""
        if self.options.backend == "newton" and not self._compiled:
            before = self._kept()
            try:
                self._world.rehearse()
            except (RuntimeError, ValueError, NotImplementedError) as error:
                raise self._refused(error) from None
            self._put(before, None, self._made)
            self._physics.rewind()
            self._physics.store()  # which forgets what that step has shown
        self._compiled = True
        self._world.state()

    def reserve(self, n_step: int) -> None:
        """See Simulator.reserve; longer blocks are made in parts."""
        import warp as wp

        rows = min(n_step, self._rows())
        if self._slots is None or self._slots.rows < rows:
            shapes = zip(_STATES, (array.shape for array in self._world.state()), strict=True)
            self._slots = WarpSlots(self._device, {name: ((rows, *shape), wp.float32) for name, shape in shapes})

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""
        if self._model is not None and actions is not None:
            self._world.prepare(actions)

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold."""
        self._world.hold(controls)

    def imported(self) -> Imported | None:
        """See Simulator.imported: PhysX's tensors of links and degrees of freedom, or what MuJoCo Warp steps."""
        return None if self._model is None else self._model.imported(self.dt)

    def link_poses(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See Simulator.link_poses: where the engine has the links."""
        positions, orientations = self._model.link_poses()
        return positions, orientations

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        if not self._compiled:
            self.compile("timed")
        self._stepped = True
        for _ in range(n_step):
            self._world.step()
        self._made += n_step
        self._wait()

    def _wait(self) -> None:
        if self._device.is_cuda:
            import warp as wp

            wp.synchronize_device(self._device)

    def state(self) -> States:
        """See Simulator.state."""
        poses, speeds = self._world.state()
        return tuple(array[0] for array in self._world.split(poses[None].cpu().numpy(), speeds[None].cpu().numpy()))

    def _fill(self, slots: Slots, slot: Slot, n_step: int) -> Captured:
        import warp as wp

        self.compile("capture")
        kept = [wp.to_torch(slot.arrays[name]) for name in _STATES]
        self._physics.rewind()
        for row in range(n_step):
            self._world.step()
            for rows, array in zip(kept, self._world.state(), strict=True):
                rows[row].copy_(array)
            self._physics.store()
        self._wait()  # torch's copies, which have a stream of their own, too
        slots.begin_copy(slot, n_step)
        self._made += n_step
        self._counted, self._stepped = self._physics.evidence(n_step), False
        world, counted = self._world, self._counted
        return SlotBlock(
            slots, slot, n_step,
            split=lambda host, envs: world.split(*(host(name)[:, envs] for name in _STATES)),
            told=lambda host: counted,
        )  # fmt: skip

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        return _CLAIMS.get(options.backend, StateClaims())

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        return Snapshot(self._made, self._kept())

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        self._put(picked(snapshot.arrays, envs), envs, snapshot.step)

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: the first state is written, as tasks of Isaac Lab do."""
        self._put(picked(self._first, envs), envs, 0)

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state."""
        arrays = {name: array.copy() for name, array in picked(self._first, envs).items()}
        arrays[_POSES], arrays[_SPEEDS] = self._world.merged(states, arrays[_POSES], arrays[_SPEEDS])
        self._put(arrays, envs, 0)

    def _kept(self) -> dict[str, NDArray[Any]]:
        poses, speeds = (array.cpu().numpy().copy() for array in self._world.state())
        return {_POSES: poses, _SPEEDS: speeds, **self._physics.kept()}

    def _put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs, made: int) -> None:
        self._world.put(arrays[_POSES], arrays[_SPEEDS], envs)
        self._physics.put(arrays, envs)
        if envs is None:
            self._made = made

    def evidence(self) -> Evidence | None:
        """See Simulator.evidence."""
        if self._stepped:
            self._physics.rewind()
            self._physics.store()
            self._counted, self._stepped = self._physics.evidence(1), False
        return self._counted

    def gates(self) -> list[str]:
        """See Simulator.gates."""
        gates: list[str] = self._physics.gates()
        return gates

    def allocator_bytes(self) -> tuple[int, int] | None:
        """See Simulator.allocator_bytes; PhysX has an allocator of its own, which does not tell."""
        return warp_runtime.allocator_bytes(self._device) if self.options.backend == "newton" else None

    def close(self) -> None:
        """See Simulator.close."""
        for name in ("_slots", "_world", "_physics"):
            held = vars(self).pop(name, None)
            if name != "_slots" and held is not None:
                held.close()


def _without_pinned_memory() -> None:
    """Isaac Lab keeps host arrays in pinned memory on the CPU as well, which takes a CUDA driver."""
    import warp as wp

    if not wp.is_cuda_available():
        host = wp.get_device("cpu")
        host.pinned_allocator = host.default_allocator
