"""A task of ManiSkill that needs no renderer, and trajectories of it by ManiSkill's own RecordEpisode."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import sapien
import torch

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of what ManiSkill imports for rendering and training
    from mani_skill.envs.tasks.empty_env import EmptyEnv
    from mani_skill.utils.registration import register_env
    from mani_skill.utils.structs.pose import Pose
    from mani_skill.utils.wrappers.record import RecordEpisode

TASK = "tests.maniskill_tasks:GsbPushing-v1"
STEPS = 12
SEEDS = (3, 4, 5)


@register_env("GsbPushing-v1", max_episode_steps=8)  # after which trajectories go on
class Pushing(EmptyEnv):  # type: ignore[misc]
    """A Panda with a cube between its fingers, at a place that the seed draws; it succeeds where the cube goes down."""

    SUPPORTED_REWARD_MODES = ("dense",)

    def _load_scene(self, options: Any) -> None:
        super()._load_scene(options)
        builder = self.scene.create_actor_builder()
        builder.add_box_collision(half_size=[0.02, 0.02, 0.02])
        builder.initial_pose = sapien.Pose([0.5, 0.5, 0.02])
        self.cube = builder.build("cube")

    def _initialize_episode(self, env_idx: Any, options: Any) -> None:
        self.agent.reset(torch.tensor([0.0, 0.4, 0.0, -2.0, 0.0, 2.4, 0.78, 0.04, 0.04]))
        place = self.agent.tcp.pose.p.clone()
        place[:, :2] += 0.01 * (torch.rand((len(env_idx), 2)) - 0.5)
        self.cube.set_pose(Pose.create_from_pq(place))

    def evaluate(self) -> Any:
        height = self.cube.pose.p[:, 2]
        return {"success": height < 0.1, "fail": height > 10}

    def compute_dense_reward(self, obs: Any, action: Any, info: Any) -> Any:
        return self.cube.pose.p[:, 0]


def record(folder: Path, control_mode: str = "pd_joint_delta_pos", **options: Any) -> Path:
    """Write trajectories of drawn actions; returns the file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = gymnasium.make(
            "GsbPushing-v1", obs_mode="state", sim_backend="physx_cpu", render_backend="none", reward_mode="dense",
            control_mode=control_mode,
        )  # fmt: skip
        env = RecordEpisode(env, str(folder), trajectory_name="trajectory", save_video=False, **options)
        rng = np.random.default_rng(0)
        for seed in SEEDS:
            env.reset(seed=seed)
            for _ in range(STEPS):
                env.step(rng.uniform(-1, 1, env.action_space.shape).astype(np.float32))
        env.close()
    return folder / "trajectory.h5"
