"""PPO of Stable-Baselines3 on a Gymnasium task: recorded, with hashes of all that it computes between rollouts.

usage: python train.py [--seed SEED] [--updates N] [--threads N] [--device DEVICE]

It writes train.mcap, and prints the mean return of the last episodes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

import gpusimbench

TASK, N_ENV, HORIZON, BATCH = "CartPole-v1", 8, 256, 256
_OF_A_ROLLOUT = ("observations", "actions", "rewards", "episode_starts", "values", "log_probs", "advantages", "returns")


class Fingerprints(BaseCallback):
    """Hashes the rollout, every batch and gradient of an update, and the policy and optimizer that come of it."""

    def _on_training_start(self) -> None:
        envs, buffer = self.training_env, self.model.rollout_buffer
        batches = buffer.get

        def hashed(batch_size: int | None = None) -> Iterator[Any]:
            for batch in batches(batch_size):
                envs.fingerprint("batch", batch._asdict())
                yield batch

        buffer.get = hashed
        parameters = list(self.model.policy.parameters())
        self.model.policy.optimizer.register_step_pre_hook(
            lambda *_: envs.fingerprint("gradient", [one.grad for one in parameters])
        )

    def _on_rollout_start(self) -> None:  # before the first update, and after every one but the last
        self.training_env.fingerprint("policy", self.model.policy.state_dict())
        self.training_env.fingerprint("optimizer", self.model.policy.optimizer.state_dict())

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        buffer = self.model.rollout_buffer
        self.training_env.fingerprint("rollout", {name: getattr(buffer, name) for name in _OF_A_ROLLOUT})

    _on_training_end = _on_rollout_start


def train(path: str, seed: int | None, updates: int, device: str) -> list[float]:
    """Train and record; the returns of the last 100 episodes."""
    steps = updates * HORIZON
    envs = gpusimbench.wrap(make_vec_env(TASK, n_envs=N_ENV), path, steps=steps)
    model = PPO("MlpPolicy", envs, seed=seed, n_steps=HORIZON, batch_size=BATCH, device=device)
    model.learn(steps * N_ENV, callback=Fingerprints())
    envs.close()
    return [episode["r"] for episode in model.ep_info_buffer]


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seed", type=int, help="of torch, numpy and the environments; without it, nothing is seeded")
    parser.add_argument("--updates", type=int, default=4)
    parser.add_argument("--threads", type=int, default=1, help="of torch")
    parser.add_argument("--device", default="cpu", help="of torch, such as cuda")
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    returns = train("train.mcap", arguments.seed, arguments.updates, arguments.device)
    sys.stdout.write(f"mean return of the last {len(returns)} episodes: {np.mean(returns):.0f}\n")
