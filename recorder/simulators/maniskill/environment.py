"""A scene as an environment of ManiSkill's kind: a task without robot, goal, reward and end."""

from __future__ import annotations

from typing import Any

from gpusimbench.recorder.scenes.base import Body, Box, Capsule, Plane, Scene, Sphere, solid_inertia
from gpusimbench.recorder.simulators.maniskill.options import ManiSkillOptions
from gpusimbench.recorder.simulators.sapien.bodies import X_TO_Z, half, limit, make_material
from gpusimbench.schemas.errors import UsageError

_BACKENDS = {"cpu": "physx_cpu", "cuda": "physx_cuda"}


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
