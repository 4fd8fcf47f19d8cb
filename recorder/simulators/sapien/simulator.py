"""SAPIEN: PhysX 5 in scenes of SAPIEN's, without a renderer.

On the CPU each environment has a PhysxCpuSystem of its own, so that they cannot see each other and all lie at zero. On
a GPU they are scenes of one PhysxGpuSystem, at origins that are `spacing` apart.
"""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.abilities import BODIES, ROBOTS, Ability
from gpusimbench.recorder.simulators.sapien.arm import add_arm
from gpusimbench.recorder.simulators.sapien.bodies import add_bodies
from gpusimbench.recorder.simulators.sapien.complaints import Complaints
from gpusimbench.recorder.simulators.sapien.cpu import CpuWorlds
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.recorder.simulators.sapien.settings import configure
from gpusimbench.recorder.simulators.sapien.stepper import Made, SapienStepper


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
        from gpusimbench.recorder.simulators.sapien.settings import check_gpu, enable_gpu, library_path, sha256
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
