"""ManiSkill: an environment of its kind on SAPIEN, stepped as training code steps them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

from gpusimbench.recorder.abilities import BODIES
from gpusimbench.recorder.options import one_of
from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Plane, Scene, Sphere, solid_inertia
from gpusimbench.recorder.simulators.sapien.bodies import X_TO_Z, half, limit, make_material
from gpusimbench.recorder.simulators.sapien.complaints import Complaints
from gpusimbench.recorder.simulators.sapien.cpu import CpuWorlds
from gpusimbench.recorder.simulators.sapien.options import SapienOptions
from gpusimbench.recorder.simulators.sapien.settings import check_gpu, configure, enable_gpu, library_path, sha256
from gpusimbench.recorder.simulators.sapien.simulator import Made, SapienStepper
from gpusimbench.schemas.errors import UsageError

_BACKENDS = {"cpu": "physx_cpu", "cuda": "physx_cuda"}
_COVERS = "BaseEnv.step without action, observation or reward: one step of PhysX, and ManiSkill's own bookkeeping"


@dataclass(frozen=True)
class ManiSkillOptions(SapienOptions):
    """Options of PhysX, with what ManiSkill's SimConfig and SceneConfig have for them.

    device                auto (as ManiSkill chooses: the CPU for one environment, a GPU for more), cpu or cuda
    angular_damping       ManiSkill sets none, so that PhysX's default is in force
    max_angular_velocity  the same
    """

    device: str = "auto"
    solver_position_iterations: int = 15
    solver_velocity_iterations: int = 1
    bounce_threshold: float = 2.0
    contact_offset: float = 0.02
    rest_offset: float = 0.0
    sleep_threshold: float = 0.005
    angular_damping: float = 0.05
    max_angular_velocity: float = 100.0

    def _check_device(self) -> None:
        one_of("device", self.device, ("auto", "cpu", "cuda"))

    def chosen_device(self, n_env: int) -> str:
        """The kind of device that steps so many environments: "cpu" or "cuda"."""
        if self.device == "auto":
            return "cuda" if n_env > 1 else "cpu"
        return self.device


def make_environment(
    scene: Scene,
    *,
    n_env: int,
    frequency: int,
    device: str,
    options: ManiSkillOptions,
    enhanced_determinism: bool,
    capacities: dict[str, int],
) -> Any:
    """A mani_skill BaseEnv of the scene, in its initial state.

    frequency   steps per second, of the simulation and of control [Hz]
    device      "cpu" or "cuda"
    capacities  of the buffers on a GPU, by name; empty: ManiSkill's own

    UsageError with ManiSkill's words for more than one environment on the CPU.
    """
    import torch
    from mani_skill.envs.sapien_env import BaseEnv
    from mani_skill.utils.structs.pose import Pose
    from mani_skill.utils.structs.types import GPUMemoryConfig, SceneConfig, SimConfig

    class SceneEnv(BaseEnv):  # type: ignore[misc]
        """The scene, one step of physics for each step of control."""

        SUPPORTED_ROBOTS = ("none",)

        @property
        def _default_sim_config(self) -> Any:
            return SimConfig(
                spacing=options.spacing,
                sim_freq=frequency,
                control_freq=frequency,
                gpu_memory_config=GPUMemoryConfig(**capacities),
                scene_config=SceneConfig(
                    gravity=list(scene.gravity),
                    bounce_threshold=options.bounce_threshold,
                    sleep_threshold=options.sleep_threshold,
                    contact_offset=options.contact_offset,
                    rest_offset=options.rest_offset,
                    solver_position_iterations=options.solver_position_iterations,
                    solver_velocity_iterations=options.solver_velocity_iterations,
                    enable_pcm=options.enable_pcm,
                    enable_tgs=options.enable_tgs,
                    enable_ccd=options.enable_ccd,
                    enable_enhanced_determinism=enhanced_determinism,
                    enable_friction_every_iteration=options.enable_friction_every_iteration,
                    cpu_workers=options.cpu_workers,
                ),
            )

        def _load_scene(self, _: dict[str, Any]) -> None:
            self.moving = []
            for body in scene.bodies:
                actor = _build(self.scene, body)
                if not body.fixed:
                    for component in components_of(actor):
                        limit(component, options)
                    self.moving.append(actor)

        def _initialize_episode(self, env_idx: Any, _: dict[str, Any]) -> None:
            def same(values: tuple[float, ...]) -> Any:
                return torch.tensor([values], dtype=torch.float32, device=self.device).repeat(len(env_idx), 1)

            for body, actor in zip(scene.moving(), self.moving, strict=True):
                actor.set_pose(Pose.create(same((*body.position, *body.orientation))))
                actor.set_linear_velocity(same(body.linear_velocity))
                actor.set_angular_velocity(same(body.angular_velocity))

        def get_state_dict(self) -> Any:
            """The state of the scene; BaseEnv asks its robot as well, whether there is one or not."""
            return self.scene.get_sim_state()

    try:
        return SceneEnv(
            num_envs=n_env,
            robot_uids="none",
            obs_mode="none",
            reward_mode="none",
            sim_backend=_BACKENDS[device],
            render_backend="none",
        )
    except RuntimeError as error:
        if device == "cpu" and n_env > 1:
            words = " ".join(str(error).split())
            raise UsageError(f"ManiSkill steps one environment on the CPU, not {n_env}; it says: {words}") from None
        raise


def components_of(actor: Any) -> list[Any]:
    """The PhysxRigidDynamicComponent of a ManiSkill actor in each environment."""
    from sapien import physx

    return [entity.find_component_by_type(physx.PhysxRigidDynamicComponent) for entity in actor._objs]


def _build(scene: Any, body: Body) -> Any:
    """Add a body to every environment of a ManiSkillScene; returns the actor."""
    import sapien

    builder = scene.create_actor_builder()
    builder.initial_pose = sapien.Pose(body.position, body.orientation)
    material = make_material(body.material)
    along_z = sapien.Pose((0.0, 0.0, 0.0), X_TO_Z)
    match body.shape:
        case Box(size):
            builder.add_box_collision(half_size=half(size), material=material)
        case Sphere(radius):
            builder.add_sphere_collision(radius=radius, material=material)
        case Capsule(radius, length):
            builder.add_capsule_collision(along_z, radius=radius, half_length=length / 2, material=material)
        case Plane():
            builder.add_plane_collision(along_z, material=material)
    if body.mass is None:
        return builder.build_static(body.name)
    builder.set_mass_and_inertia(body.mass, sapien.Pose(), solid_inertia(body.shape, body.mass))
    return builder.build(body.name)


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
        from gpusimbench.recorder.simulators.sapien.sizes import choose_sizes

        try:
            check_gpu()
        except UsageError as error:
            if self.n_env == 1:
                raise
            more = f"ManiSkill steps one environment on the CPU (--n-env 1), and {self.n_env} on a GPU"
            raise UsageError(f"{more}; {error}") from None
        import torch
        from mani_skill.utils.structs.types import GPUMemoryConfig
        from sapien import physx

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
    (component,) = components_of(actor)
    return component
