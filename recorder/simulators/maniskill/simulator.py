"""ManiSkill: an environment of its kind on SAPIEN, stepped as training code steps them."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

from gpusimbench.recorder.abilities import BODIES
from gpusimbench.recorder.simulators.maniskill.options import ManiSkillOptions
from gpusimbench.recorder.simulators.sapien.complaints import Complaints
from gpusimbench.recorder.simulators.sapien.cpu import CpuWorlds
from gpusimbench.recorder.simulators.sapien.settings import configure
from gpusimbench.recorder.simulators.sapien.stepper import Made, SapienStepper
from gpusimbench.schemas.errors import UsageError

_COVERS = "BaseEnv.step without action, observation or reward: one step of PhysX, and ManiSkill's own bookkeeping"


class ManiSkill(SapienStepper):
    """N environments of a mani_skill.envs.sapien_env.BaseEnv."""

    Options = ManiSkillOptions
    distribution = "mani_skill"
    abilities = BODIES

    def make(self, complaints: Complaints) -> Made:
        """See SapienStepper.make."""
        options: ManiSkillOptions = self.options
        frequency = round(1 / self.dt)
        if abs(frequency * self.dt - 1) > 1e-9:
            raise UsageError(f"ManiSkill makes a whole number of steps a second; dt is {self.dt:g} s")
        if options.chosen_device(self.n_env) == "cuda":
            return self._on_gpu(frequency, complaints)
        environment = self._environment(frequency, "cpu", {})
        system = environment.scene.px
        worlds = CpuWorlds(
            self.scene,
            [system],
            [[_only(actor) for actor in environment.moving]],
            [],
            steps=[lambda: environment.step(None)],
            timing_covers=_COVERS,
        )
        return self._made_of(environment, worlds)

    def _environment(self, frequency: int, device: str, capacities: dict[str, int]) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of what ManiSkill imports for rendering and training
            from gpusimbench.recorder.simulators.maniskill.environment import make_environment

            return make_environment(
                self.scene,
                n_env=self.n_env,
                frequency=frequency,
                device=device,
                options=self.options,
                enhanced_determinism=self.enhanced,
                capacities=capacities,
            )

    def _made_of(self, environment: Any, worlds: Any) -> Made:
        import mani_skill
        import sapien
        import torch

        return Made(
            worlds,
            mani_skill.__version__,
            {
                "sim_backend": environment.backend.sim_backend,
                "sim_freq": environment.sim_freq,
                "control_freq": environment.control_freq,
                "sapien": sapien.__version__,
                "torch": torch.__version__,
            },
            keep=(environment,),
        )

    def _on_gpu(self, frequency: int, complaints: Complaints) -> Made:
        from gpusimbench.recorder.simulators.sapien.gpu import GpuWorlds
        from gpusimbench.recorder.simulators.sapien.released import sha256
        from gpusimbench.recorder.simulators.sapien.settings import check_gpu, enable_gpu, library_path
        from gpusimbench.recorder.simulators.sapien.sizes import choose_sizes

        try:
            check_gpu()
        except UsageError as error:
            raise UsageError(f"ManiSkill steps {self.n_env} environments on a GPU; {error}") from None
        import torch
        from mani_skill.utils.structs.types import GPUMemoryConfig
        from sapien import physx

        from gpusimbench.recorder.simulators.maniskill.environment import components_of

        options: ManiSkillOptions = self.options
        configure(options, gravity=self.scene.gravity, enhanced_determinism=self.enhanced)
        shipped = GPUMemoryConfig().dict()
        buffers = choose_sizes(self.scene, n_env=self.n_env, dt=self.dt, options=options, defaults=shipped)
        enable_gpu()
        environment = self._environment(frequency, "cuda", {buffer.name: buffer.asked for buffer in buffers})
        system = environment.scene.px
        offsets = [system.get_scene_offset(scene) for scene in environment.scene.sub_scenes]
        actors = [components_of(actor) for actor in environment.moving]
        worlds = GpuWorlds(
            self.scene,
            system,
            [list(bodies) for bodies in zip(*actors, strict=True)],
            origins=tuple((float(x), float(y), float(z)) for x, y, z in offsets),
            buffers=buffers,
            complaints=complaints,
            step=lambda: environment.step(None),
            timing_covers=f"{_COVERS}, which fetches the state of all bodies",
        )
        torch.cuda.synchronize()
        made = self._made_of(environment, worlds)
        digest = sha256(library_path(physx.version()))
        return replace(made, switches={**made.switches, "physx_gpu_library_sha256": digest})


def _only(actor: Any) -> Any:
    from gpusimbench.recorder.simulators.maniskill.environment import components_of

    (component,) = components_of(actor)
    return component
