"""Makes the data sets of this folder with the library LeRobot, which has to be installed: python make.py.

Drawn actions in Gymnasium's Reacher and in PushT: three episodes each, of 12 frames.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

LONGEST, SEEDS = 12, (7, 2**60 + 1, 3)


def dataset(name: str, fps: int, features: dict[str, tuple[str, int]]) -> Any:
    """A data set without video."""
    given = {key: {"dtype": dtype, "shape": (n,), "names": None} for key, (dtype, n) in features.items()}
    here = Path(__file__).parent / name
    return LeRobotDataset.create(repo_id=f"gpusimbench/{name}", fps=fps, features=given, root=here, use_videos=False)


def reach() -> None:
    """With the features that a replay begins with: the seed, and the state of the physics."""
    env = gymnasium.make("Reacher-v5", max_episode_steps=LONGEST)
    made = dataset(
        "reach",
        50,
        {
            "observation.state": ("float32", 10),
            "action": ("float32", 2),
            "next.reward": ("float32", 1),
            "seed": ("int64", 1),
            "physics.qpos": ("float64", 4),
            "physics.qvel": ("float64", 4),
        },
    )
    env.action_space.seed(0)
    for seed in SEEDS:
        seen, done = env.reset(seed=seed)[0], False
        while not done:
            data, action = env.unwrapped.data, env.action_space.sample()
            frame = {"observation.state": seen.astype(np.float32), "action": action, "seed": np.array([seed])}
            frame |= {"physics.qpos": data.qpos.copy(), "physics.qvel": data.qvel.copy(), "task": "reach"}
            seen, reward, terminated, truncated, _ = env.step(action)
            made.add_frame({**frame, "next.reward": np.array([reward], np.float32)})
            done = terminated or truncated
        made.save_episode()
    made.finalize()


def pusht() -> None:
    """As LeRobot's own data sets are: no seed, no state, success at each frame."""
    env = gymnasium.make("gym_pusht:gym_pusht/PushT-v0", obs_type="environment_state_agent_pos")
    made = dataset(
        "pusht",
        10,
        {
            "observation.state": ("float32", 2),
            "observation.environment_state": ("float32", 16),
            "action": ("float32", 2),
            "next.reward": ("float32", 1),
            "next.success": ("bool", 1),
        },
    )
    env.action_space.seed(0)
    for seed in SEEDS:
        seen = env.reset(seed=seed % 2**32)[0]
        for _ in range(LONGEST):
            action = env.action_space.sample()
            frame = {
                "observation.state": seen["agent_pos"].astype(np.float32),
                "observation.environment_state": seen["environment_state"].astype(np.float32),
                "action": action,
                "task": "push",
            }
            seen, reward, _, _, info = env.step(action)
            told = {"next.reward": np.array([reward], np.float32), "next.success": np.array([info["is_success"]])}
            made.add_frame({**frame, **told})
        made.save_episode()
    made.finalize()


if __name__ == "__main__":
    reach()
    pusht()
