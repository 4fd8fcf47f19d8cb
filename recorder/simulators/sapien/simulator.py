"""SAPIEN: PhysX 5 in scenes of SAPIEN's, without a renderer.

On the CPU each environment has a PhysxCpuSystem of its own, so that they cannot see each other and all lie at zero. On
a GPU they are scenes of one PhysxGpuSystem, at origins that are `spacing` apart.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.recorder.abilities import BODIES, ROBOTS, Ability
from gpusimbench.recorder.simulators.base import Description, Simulator, States
from gpusimbench.recorder.simulators.evidence import Evidence
from gpusimbench.recorder.simulators.sapien.arm import add_arm
from gpusimbench.recorder.simulators.sapien.bodies import add_bodies
from gpusimbench.recorder.simulators.sapien.complaints import Complaints
from gpusimbench.recorder.simulators.sapien.cpu import CpuWorlds
from gpusimbench.recorder.simulators.sapien.deviations import deviations
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.recorder.simulators.sapien.settings import (
    check_gpu,
    configure,
    enable_gpu,
    library,
    library_path,
    modification,
    sha256,
)
from gpusimbench.recorder.simulators.sapien.worlds import Worlds
from gpusimbench.recorder.simulators.snapshot import Envs, Snapshot, StateClaims, absent, partial, picked
from gpusimbench.schemas.provenance import MODIFIED

LEVELS = {
    "default": "PhysX as it ships, without enhanced determinism",
    "enhanced": "PhysX's enhanced determinism (enable_enhanced_determinism): bodies that do not meet do not influence "
    "each other, in whatever order they were added",
}


@dataclass(frozen=True)
class Made:
    """Environments that are ready to step, and what is to be said of them.

    version   of the engine that the user asked for
    switches  beside those of PhysX
    keep      what must live as long as they do
    """

    worlds: Worlds
    version: str
    switches: dict[str, Any]
    keep: tuple[Any, ...] = ()


class SapienStepper(Simulator):
    """N environments that PhysX steps through SAPIEN."""

    determinism_levels = LEVELS

    _complaints: Complaints | None = None

    @abstractmethod
    def make(self, complaints: Complaints) -> Made:
        """The environments; UsageError where they cannot be had."""

    def build(self) -> Description:
        """See Simulator.build."""
        import sapien
        from sapien import physx

        complaints = self._complaints = Complaints()
        made = self._made = self.make(complaints)
        worlds = self._worlds = made.worlds
        self._done = 0  # steps since the build
        options: SapienOptions = self.options
        buffers = {buffer.name: buffer.asked for buffer in worlds.buffers} if worlds.device != "cpu" else None
        digest = sha256(library())
        modified = modification(sapien.__version__, physx.version(), digest)
        return Description(
            version=made.version,
            device=worlds.device,
            options=options.in_force("cpu" if worlds.device == "cpu" else "cuda", buffers),
            switches={
                "precision": "float32",
                "determinism": self.determinism,
                "enable_enhanced_determinism": self.enhanced,
                "physx": physx.version(),
                "libsapien_sha256": digest,
                **({MODIFIED: modified} if modified else {}),
                **made.switches,
            },
            deviations=deviations(self.scene, options),
            fields=worlds.fields,
            timing_covers=worlds.timing_covers,
            env_origins=worlds.env_origins,
            buffers=worlds.buffers,
            counters=worlds.counters,
            overflow_bits=worlds.overflow_bits,
        )

    @property
    def enhanced(self) -> bool:
        """Whether PhysX's enhanced determinism is asked for."""
        return self.determinism == "enhanced"

    def prepare(self, actions: NDArray[np.float32] | None) -> None:
        """See Simulator.prepare."""
        self._worlds.prepare(actions)

    def step(self, n_step: int) -> None:
        """See Simulator.step."""
        self._worlds.advance(n_step)
        self._done += n_step

    def applied(self) -> NDArray[np.float32] | None:
        """See Simulator.applied."""
        return None if self.scene.actions is None else self._worlds.applied()

    def state(self) -> States:
        """See Simulator.state."""
        return self._worlds.state()

    def states(self, n_step: int) -> States:
        """See Simulator.states."""
        self._done += n_step
        return self._worlds.record(n_step)

    @classmethod
    def state_claims(cls, options: Any) -> StateClaims:
        """See Simulator.state_claims."""
        if options.device != "cpu":
            return StateClaims(*(absent("implemented on the CPU only, with --option device=cpu") for _ in range(4)))
        return StateClaims(*(partial("contacts and friction anchors that PhysX keeps to itself") for _ in range(4)))

    @property
    def _on_cpu(self) -> CpuWorlds:
        assert isinstance(self._worlds, CpuWorlds)  # nothing is claimed elsewhere
        return self._worlds

    def snapshot(self) -> Snapshot:
        """See Simulator.snapshot."""
        return Snapshot(self._done, self._on_cpu.kept())

    def restore(self, snapshot: Snapshot, envs: Envs = None) -> None:
        """See Simulator.restore."""
        self._on_cpu.put(picked(snapshot.arrays, envs), envs)
        if envs is None:
            self._done = snapshot.step

    def reset(self, envs: Envs = None) -> None:
        """See Simulator.reset: PhysxCpuSystem.unpack of the first state."""
        self._on_cpu.begin(envs)
        if envs is None:
            self._done = 0

    def set_state(self, states: States, envs: Envs = None) -> None:
        """See Simulator.set_state: PhysxCpuSystem.unpack of the first state with these poses and velocities."""
        self._on_cpu.place(states, envs)
        if envs is None:
            self._done = 0

    def evidence(self) -> Evidence:
        """See Simulator.evidence."""
        return self._worlds.evidence()

    def gates(self) -> list[str]:
        """See Simulator.gates; whatever PhysX complains of is a gate."""
        return [] if self._complaints is None else self._complaints.take_sentences()

    def close(self) -> None:
        """See Simulator.close."""
        for name in ("_worlds", "_made"):
            vars(self).pop(name, None)
        if self._complaints is not None:
            self._complaints.close()


class Sapien(SapienStepper):
    """N environments on SAPIEN."""

    Options = SapienOptions
    distribution = "sapien"
    abilities = BODIES | ROBOTS

    @classmethod
    def withheld(cls, options: Any) -> dict[Ability, str]:
        """See Simulator.withheld: there are no robots on a GPU yet."""
        return dict.fromkeys(ROBOTS, "--option device=cpu") if options.device == "cuda" else {}

    def make(self, complaints: Complaints) -> Made:
        """See SapienStepper.make."""
        import sapien

        options: SapienOptions = self.options
        if options.device == "cuda":
            return self._on_gpu(complaints)
        configure(options, gravity=self.scene.gravity, enhanced_determinism=self.enhanced)
        scenes, systems, bodies = [], [], []
        arms: list[Any] = []
        for _ in range(self.n_env):
            system = sapien.physx.PhysxCpuSystem()
            system.timestep = self.dt
            scene = sapien.Scene([system])
            bodies.append(add_bodies(scene, self.scene, options))
            if self.scene.robot is not None:
                arms.append(add_arm(scene, self.scene.robot, options))
            scenes.append(scene)
            systems.append(system)
        worlds = CpuWorlds(
            self.scene,
            systems,
            bodies,
            arms,
            steps=[system.step for system in systems],
            timing_covers="PhysxCpuSystem.step of one environment after the other, which also copies poses to SAPIEN's "
            "entities",
        )
        return Made(
            worlds,
            sapien.__version__,
            {"system": "a PhysxCpuSystem for each environment"},
            keep=(scenes,),
        )

    def _on_gpu(self, complaints: Complaints) -> Made:
        import sapien
        from sapien import physx

        from gpusimbench.recorder.simulators.sapien.gpu import GpuWorlds, square_grid
        from gpusimbench.recorder.simulators.sapien.sizes import DEFAULTS, choose_sizes

        options: SapienOptions = self.options
        check_gpu()
        configure(options, gravity=self.scene.gravity, enhanced_determinism=self.enhanced)
        # counted before the GPU is on: SAPIEN then warns of every system on the CPU
        buffers = choose_sizes(self.scene, n_env=self.n_env, dt=self.dt, options=options, defaults=DEFAULTS)
        enable_gpu()
        physx.set_gpu_memory_config(**{buffer.name: buffer.asked for buffer in buffers})
        system: Any = physx.PhysxGpuSystem("cuda")
        system.timestep = self.dt
        origins = square_grid(self.n_env, options.spacing)
        scenes, bodies = [], []
        for env, origin in enumerate(origins):
            scene = sapien.Scene([system])
            system.set_scene_offset(scene, origin)
            # an infinite plane is there for the bodies of all environments
            bodies.append(add_bodies(scene, self.scene, options, planes=env == 0))
            scenes.append(scene)
        system.gpu_init()
        worlds = GpuWorlds(
            self.scene,
            system,
            bodies,
            origins=origins,
            buffers=buffers,
            complaints=complaints,
            step=system.step,
            timing_covers="PhysxGpuSystem.step of all environments; nothing is fetched",
        )
        worlds.begin()
        return Made(
            worlds,
            sapien.__version__,
            {
                "system": "one PhysxGpuSystem, a scene at an origin of its own for each environment",
                "physx_gpu_library_sha256": sha256(library_path(physx.version())),
            },
            keep=(scenes,),
        )
