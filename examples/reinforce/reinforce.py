"""A policy gradient on a Gymnasium task, in numpy: recorded with hashes of its policy, batches and gradients.

REINFORCE with a linear Gaussian policy and Adam, on InvertedPendulum. Each update collects HORIZON steps of N_ENV
environments and passes once over the samples in batches, in random order.

usage: python reinforce.py [SEED] [UPDATES]        writes train.mcap, and prints the mean length of episodes
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

import gpusimbench

TASK, N_ENV, HORIZON, BATCH = "InvertedPendulum-v5", 8, 64, 128
_DISCOUNT, _SD, _RATE = 0.97, 0.5, 0.05

Array = NDArray[np.float64]


class Adam:
    """Adam (Kingma and Ba, ICLR 2015), upward, for one array of parameters."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.mean, self.square, self.steps = np.zeros(shape), np.zeros(shape), 0

    def step(self, gradient: Array) -> Array:
        """What is added to the parameters."""
        self.steps += 1
        self.mean += 0.1 * (gradient - self.mean)
        self.square += 0.001 * (gradient**2 - self.square)
        mean, square = self.mean / (1 - 0.9**self.steps), self.square / (1 - 0.999**self.steps)
        return _RATE * mean / (np.sqrt(square) + 1e-8)


def returns_of(rewards: Array, ended: NDArray[np.bool_]) -> Array:
    """Discounted sum of rewards until the episode ends, [step, env]."""
    total, found = np.zeros(rewards.shape[1]), np.empty_like(rewards)
    for step in reversed(range(len(rewards))):
        total = rewards[step] + _DISCOUNT * np.where(ended[step], 0, total)
        found[step] = total
    return found


def rollout(envs: Any, seen: Array, weights: Array, rng: np.random.Generator) -> tuple[Array, dict[str, Array], float]:
    """Collect HORIZON steps; the last observation, the samples, and the mean length of episodes that ended."""
    rows: list[tuple[Any, ...]] = []
    begins = np.zeros(N_ENV, dtype=np.bool_)  # a call of step that begins an episode ignores its action
    for _ in range(HORIZON):
        noise = rng.normal(size=(N_ENV, weights.shape[1]))
        action = seen @ weights + _SD * noise
        after, reward, terminated, truncated, _ = envs.step(np.clip(action, -3, 3).astype(np.float32))
        rows.append((seen, noise, reward, terminated | truncated, ~begins))
        seen, begins = after, terminated | truncated
    observations, noises, rewards, ended, made = map(np.array, zip(*rows, strict=True))
    returns = returns_of(rewards, ended)[made]
    samples = {
        "observation": observations[made],
        "noise": noises[made],
        "advantage": (returns - returns.mean()) / (returns.std() + 1e-8),
    }
    return seen, samples, made.sum() / max(1, ended.sum())


def train(path: str | Path, seed: int = 0, updates: int = 20) -> list[float]:
    """Train and record; the mean length of episodes in each update."""
    rng = np.random.default_rng(seed)
    envs = gpusimbench.wrap(gymnasium.make_vec(TASK, num_envs=N_ENV), path, steps=updates * HORIZON)
    weights = 0.1 * rng.normal(size=(envs.single_observation_space.shape[0], envs.single_action_space.shape[0]))
    adam, lengths = Adam(weights.shape), []
    envs.fingerprint("policy", weights)
    seen, _ = envs.reset(seed=seed)
    for _ in range(updates):
        seen, samples, length = rollout(envs, seen, weights, rng)
        order = rng.permutation(len(samples["advantage"]))
        for begin in range(0, len(order), BATCH):
            batch = {name: array[order[begin : begin + BATCH]] for name, array in samples.items()}
            envs.fingerprint("batch", batch)
            score = batch["noise"] / _SD * batch["advantage"][:, None]  # d log density / d mean, times the advantage
            gradient = batch["observation"].T @ score / len(score)
            envs.fingerprint("gradient", gradient)
            weights = weights + adam.step(gradient)
            envs.fingerprint("policy", weights)
        lengths.append(length)
    envs.close()
    return lengths


if __name__ == "__main__":
    for number, length in enumerate(train("train.mcap", *map(int, sys.argv[1:]))):
        sys.stdout.write(f"update {number}: episodes of {length:.0f} steps\n")
