"""PhysX through ovphysx: on a GPU, or on the CPU.

All environments are in one PhysX scene: environment 0 is read from USD, and the others are clones of it, beside each
other on a grid, or on a GPU all at the same place. On a GPU states stay there; for a capture those of each step are
gathered in a ring on the device, of which one block is copied to the host while the next is being filled.
"""

from __future__ import annotations

import gc
import math
import os
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS, Ability
from gpusimbench.recorder.failure import Refused
from gpusimbench.recorder.options import parse_options
from gpusimbench.recorder.scenes.base import Scene
from gpusimbench.recorder.scenes.emit.usd import emit_usd
from gpusimbench.recorder.scenes.model import ModelScene
from gpusimbench.recorder.simulators.base import Description
from gpusimbench.recorder.simulators.captured import BLOCK_BYTES, BLOCK_STEPS, Captured, States
from gpusimbench.recorder.simulators.physx.deviations import deviations
from gpusimbench.recorder.simulators.physx.options import OF_MODELS, OF_THE_GPU, PhysxOptions, apis, broad_phase
from gpusimbench.recorder.simulators.slots import Slot, SlotBlock, Slots, Slotted
from gpusimbench.recorder.simulators.snapshot import Envs, Snapshot, StateClaims, partial, picked
from gpusimbench.recorder.simulators.warp import runtime as warp_runtime
from gpusimbench.recorder.simulators.warp.transfer import WarpSlots
from gpusimbench.schemas.errors import GsbError, UsageError
from gpusimbench.schemas.imported import Imported
from gpusimbench.schemas.provenance import Buffer


class Physx(Slotted):
    """N environments in one PhysX scene."""

    Options = PhysxOptions
    distribution = "ovphysx"
    abilities = BODIES | ROBOTS - {Ability.ROBOT_AMONG_BODIES} | {Ability.MODELS}
    blocks_ahead = 2
    determinism_levels = {
        "default": "the engine as it ships: what an environment does may depend on how many others there are",
        "enhanced": "physxScene:enableEnhancedDeterminism: what an environment does does not depend on the others, "
        "but still on where it stands",
    }
    levels_without_effect = {
        "cuda": {"enhanced": "on an H100 and an H200, runs have the same bits with and without it"},
    }

    @classmethod
    def parsed(cls, name: str, scene: Scene, given: Mapping[str, str]) -> Any:
        """See Simulator.parsed: of a model's pair of geoms, friction is the larger one, as it is in MuJoCo."""
        given = {option: value for option, value in given.items() if option not in scene.own_options}
        return parse_options(name, cls.Options, {**OF_MODELS, **given} if isinstance(scene, ModelScene) else given)

    @classmethod
    def withheld(cls, options: Any) -> dict[Ability, str]:
        """See Simulator.withheld: environments beside each other share a plane."""
        return {Ability.TILTED_PLANES: "a box, or --option spacing=0 on a GPU"} if options.spacing else {}

    def build(self) -> Description:
        """See Simulator.build."""
        options: PhysxOptions = self.options
        robot = self.scene.robot
        device = self._device = warp_runtime.start(options.device)
        gpu = bool(device.is_cuda)
        if not gpu and not options.spacing and self.n_env > 1:
            raise UsageError(
                "option 'spacing' is above 0 where PhysX runs on the CPU: environments at the same place would collide"
            )
        import warp as wp

        from gpusimbench.recorder.simulators.physx import arms, bodies, libraries
        from gpusimbench.recorder.simulators.physx.session import Session, grid_origins, shared_bodies
        from gpusimbench.recorder.simulators.physx.sizes import choose_buffers

        origins = grid_origins(self.n_env, options.spacing)
        buffers: tuple[Buffer, ...] = ()
        capacities: dict[str, int] = {}
        if gpu:
            buffers = choose_buffers(self.scene, n_env=self.n_env, dt=self.dt, seed=self.seed, options=options)
            capacities = {buffer.name: buffer.asked for buffer in buffers}
            capacities |= {"gpuHeapCapacity": options.heap, "gpuTempBufferCapacity": options.temp_buffer}
        enhanced = self.determinism == "enhanced"
        settings = apis(options, gpu=gpu, enhanced=enhanced, capacities=capacities)
        self._model: Any = None  # of a model file
        if isinstance(self.scene, ModelScene):
            from gpusimbench.recorder.simulators.physx.model import Model

            self._model = Model(self.scene, dt=self.dt)
            usd = self._model.usd(settings, spacing=options.spacing)
        else:
            usd = emit_usd(self.scene, apis=settings, shared=shared_bodies(self.scene, options.spacing))
        threads = options.threads or len(os.sched_getaffinity(0))
        libraries.load()
        session = self._session = Session(gpu=gpu, threads=threads)
        session.open(usd)
        session.clone(self.n_env, origins)
        if gpu and (said := [line for line in session.log.peek() if "falling back to CPU" in line]):
            raise GsbError(f"out of memory: {said[0]}")
        self._start: States | None = None  # until the engine tells its state
        self._first: dict[str, NDArray[Any]]
        self._arms: Any = None  # what is given actions
        if robot is not None:
            self._arms = arms.Arms(session, self.scene, robot, n_env=self.n_env, device=device)
        elif self._model is not None:
            self._arms = self._model.articulations(session, n_env=self.n_env, origins=origins, device=device)
        self._source: Any = self._arms or bodies.Bodies(session, self.scene, n_env=self.n_env, device=device)
        self._last = wp.empty((1, *self._source.row_shape), dtype=wp.float32, device=device)
        if gpu and self._arms is None:
            if self._source.store(self._last, 0):
                raise GsbError("PhysX did not take the GPU: its states are on the host; its messages say why")
            described = bodies.described(self.scene, origins, self.n_env)
            self._start = self._source.split(described[None])
            self._first = {"bodies": described.reshape(self.n_env, -1)}
        else:
            self._first = self._source.kept()
        self._done, self._stepped = 0, False  # steps since the build, or since all were brought back; whether any
        return Description(
            version=libraries.version(),
            device=warp_runtime.name_of(device),
            options=self._in_force(gpu, threads),
            switches={
                "precision": "float32",
                "determinism": self.determinism,
                "enableEnhancedDeterminism": enhanced,
                "dynamics": "GPU" if gpu else "CPU",
                "broad_phase": broad_phase(gpu),
                "readback": "suppressed (DirectGPU)" if gpu else "on the host",
                "sleeping": "off",
                "environments": "grid" if options.spacing else "co-located, told apart by ids",
                "first_state": _first_state(gpu=gpu, tensors=self._arms is not None),
                **libraries.versions(),
            },
            deviations=(
                *deviations(self.scene, options),
                *(self._model.deviations(options, gpu=gpu) if self._model else ()),
            ),
            fields=self._source.fields(),
            timing_covers=self._covers(gpu),
            attachments={
                "scene.usda": ("model/vnd.usda", usd.encode()),
                **(self._model.compiled.attachments if self._model else {}),
            },
            env_origins=origins,
            buffers=buffers,
        )

    def _covers(self, gpu: bool) -> str:
        acts = self._arms is not None and self.scene.actions is not None
        given = "the targets of the drives, which are on the device, and " if acts else ""
        done = " and one synchronisation" if gpu else ""
        return f"{given}PhysX.step_sync of the one scene with all environments{done}; no state is copied"

    def _in_force(self, gpu: bool, threads: int) -> dict[str, Any]:
        """Every option; null for those of the GPU on a CPU. What was chosen for a size of 0 is among the buffers."""
        found = asdict(self.options) | {"device": str(self._device), "threads": threads}
        return found if gpu else found | dict.fromkeys(OF_THE_GPU)

    def compile(self, phase: str) -> None:
        """See Simulator.compile: what the states are read by, and the kernel that sorts them; PhysX comes compiled."""
        if phase == "capture":
            import warp as wp

            from gpusimbench.recorder.simulators.physx import kernels

            self._source.begin()
            wp.load_module(kernels, device=self._device)

    def reserve(self, n_step: int) -> None:
        """See Simulator.reserve; longer blocks are made in parts."""
        import warp as wp

        shape = self._source.row_shape
        rows = max(1, min(n_step, BLOCK_STEPS, BLOCK_BYTES // (4 * math.prod(shape))))
        if self._slots is None or self._slots.rows < rows:
            self._slots = WarpSlots(self._device, {"states": ((rows, *shape), wp.float32)})

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""
        if self._arms is not None and actions is not None:
            self._arms.prepare(actions)

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        return None if self._arms is None else self._arms.applied()

    def imported(self) -> Imported | None:
        """See Simulator.imported: PhysX's tensors of links and degrees of freedom."""
        return None if self._model is None else self._model.imported(self.dt)

    def link_poses(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """See Simulator.link_poses: where PhysX has the links."""
        positions, orientations = self._model.link_poses()
        return positions, orientations

    def hold(self, controls: NDArray[np.float64]) -> None:
        """See Simulator.hold."""
        self._arms.hold(controls)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        import warp as wp

        self._advance(n_step)
        wp.synchronize_device(self._device)

    def _advance(self, n_step: int) -> None:
        self._start = None
        self._done += n_step
        self._stepped = True
        for _ in range(n_step):
            if self._arms is not None and self.scene.actions is not None:
                self._arms.command()
            self._session.physx.step_sync(self.dt)

    def state(self) -> States:
        """See Simulator.state; on a GPU, which tells nothing before the first step, the state that it was given."""
        if self._start is not None:
            return tuple(array[0] for array in self._start)
        self._source.store(self._last, 0)
        return tuple(array[0].copy() for array in self._source.split(self._last.numpy()))

    def _fill(self, slots: Slots, slot: Slot, n_step: int) -> Captured:
        """See Slotted: PhysX returns when a step is done, and the copy of the block goes on."""
        self.compile("capture")
        for row in range(n_step):
            self._advance(1)
            self._source.store_step(slot.arrays["states"], row)
        slots.begin_copy(slot, n_step)
        source = self._source
        return SlotBlock(
            slots, slot, n_step, split=lambda host, envs: source.split(host("states"), envs), told=lambda host: None
        )

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        contacts = (
            "what PhysX keeps to itself of contacts and joints, such as impulses and friction, and of a model file the "
            "last bits of the pose of a body on a free joint"
        )
        order = (
            "the order in which PhysX solves contacts, which changes as bodies leave the simulation and return to it"
            if options.device == "cpu"
            else "on a GPU the contacts of before, on a CPU the order in which PhysX solves contacts, which changes as "
            "bodies leave the simulation and return to it"
        )
        return StateClaims(partial(contacts), partial(contacts), partial(order), partial(order))

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        return Snapshot(self._done, self._first if self._start is not None else self._source.kept())

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        self._put(picked(snapshot.arrays, envs), envs, snapshot.step)

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: the engine has no operation for it, so the first state is written."""
        self._put(picked(self._first, envs), envs, 0)

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state."""
        self._put(self._source.merged(states, picked(self._first, envs)), envs, 0)

    def _put(self, arrays: Mapping[str, NDArray[Any]], envs: Envs, done: int) -> None:
        from ovphysx import TaskError

        if self._start is not None:
            self._start = None
            self._session.physx.warmup()  # a step of 1 ns: a GPU takes no state before
            self._source.put(self._first, None, stepped=False)
        try:
            self._source.put(arrays, envs, stepped=self._stepped)
        except TaskError as error:
            raise Refused(f"PhysX does not take this state: {' '.join(str(error).split())}") from None
        if envs is None:
            self._done = done

    def gates(self) -> list[str]:
        """See Simulator.gates: what PhysX said of dropped contacts, and its errors."""
        return self._session.log.take()

    def close(self) -> None:
        """See Simulator.close."""
        if vars(self).get("_source") is not None:
            self._source.close()
        for name in ("_slots", "_last", "_source", "_arms"):
            vars(self).pop(name, None)
        session = vars(self).pop("_session", None)
        gc.collect()  # the engine does not end while an array of it is alive
        if session is not None:
            session.close()


def _first_state(*, gpu: bool, tensors: bool) -> str:
    """How the first state that is recorded is known."""
    if tensors:
        return "written, and read, after a step of 1 ns"
    return "as given to the engine, which tells none before its first step" if gpu else "read from the engine"
