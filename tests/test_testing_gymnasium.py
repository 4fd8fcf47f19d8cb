"""Assertions on Gymnasium environments: single ones, vectors of each autoreset mode, and MuJoCo tasks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import UsageError
from gpusimbench.testing import assert_batch_invariant, assert_deterministic
from gpusimbench.testing.stepping import FINAL, drawn_actions, stepped
from tests.test_testing import failure

gymnasium = pytest.importorskip("gymnasium")
MODES = ("NextStep", "SameStep", "Disabled")
STEPS = 60
"""Long enough for carts to lose their poles several times."""


def carts(n_env: int, mode: str) -> Any:
    """Carts that balance poles, stepped in this process."""
    return gymnasium.make_vec(
        "CartPole-v1", num_envs=n_env, vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": gymnasium.vector.AutoresetMode(mode)},
    )  # fmt: skip


@pytest.mark.parametrize("mode", MODES)
def test_vectors(mode: str) -> None:
    """Pass environments that repeat themselves, over ends of episodes, whichever way the next episode begins."""
    assert_deterministic(lambda: carts(3, mode), STEPS, runs=3)
    assert_batch_invariant(lambda n: carts(n, mode), steps=STEPS)


class Touched(gymnasium.vector.VectorWrapper):  # type: ignore[misc,name-defined]
    """A vector environment of which one number is another in every second one that is made."""

    made = 0

    def __init__(self, envs: Any, what: str, step: int) -> None:
        super().__init__(envs)
        self.what, self.at, self.count = what, step, 0
        Touched.made += 1
        self.touched = Touched.made % 2 == 0

    def step(self, actions: Any) -> Any:
        observation, reward, terminated, truncated, info = self.env.step(actions)
        self.count += 1
        if self.touched and self.count >= self.at:
            if self.what == "observation":
                observation[1, 2] = np.nextafter(observation[1, 2], np.float32(9))
            elif self.what == "reward":
                reward[1] = np.nextafter(reward[1], 9)
            elif self.what == "truncated":
                truncated[1] = not truncated[1]
            elif "final_obs" in info:
                first = np.flatnonzero(info["_final_obs"])[0]
                info["final_obs"][first][0] += 1
        return observation, reward, terminated, truncated, info


@pytest.mark.parametrize(
    ("mode", "what", "said"),
    [
        ("NextStep", "observation", "observation[2]: 1 ULP"),
        ("SameStep", "observation", "observation[2]: 1 ULP"),
        ("Disabled", "observation", "observation[2]: 1 ULP"),
        ("NextStep", "reward", "reward: 1 ULP"),
        ("NextStep", "truncated", "truncated: 1."),
    ],
)
def test_what_differs_is_found(mode: str, what: str, said: str) -> None:
    """Find a difference in each thing that a step returns."""
    text = failure(assert_deterministic, lambda: Touched(carts(3, mode), what, 4), STEPS)
    assert text.startswith(f"run 0 and run 1 differ first at step 4, in env 1: {said}")


def test_the_last_observation_of_an_episode() -> None:
    """Find a difference in an observation that the next episode's first has replaced."""
    text = failure(assert_deterministic, lambda: Touched(carts(3, "SameStep"), FINAL, 1), STEPS)
    assert f": {FINAL}[0]: " in text
    assert f"fields {FINAL} first number" in text


def test_final_observations_are_those_before_the_reset() -> None:
    """Give the same transitions where the environment resets in the same step, and where it is reset here."""
    found = {}
    for mode in ("SameStep", "Disabled"):
        envs = carts(3, mode)
        found[mode] = stepped(envs, drawn_actions(envs, STEPS, 0), 0)
        envs.close()
    same, disabled = found["SameStep"], found["Disabled"]
    assert same.keys() == disabled.keys() == {"observation", "reward", "terminated", "truncated", FINAL}
    assert {name: rows.first for name, rows in same.items()} == {"observation": 0, **dict.fromkeys(list(same)[1:], 1)}
    done = same["terminated"].values
    assert np.array_equal(done, disabled["terminated"].values) and 3 < done.sum() < done.size / 2
    assert np.array_equal(same[FINAL].values, disabled[FINAL].values)
    assert np.array_equal(same["observation"].values, disabled["observation"].values)
    replaced = (same[FINAL].values != same["observation"].values[1:]).any(axis=-1)
    assert np.array_equal(replaced, done)


def test_a_single_environment() -> None:
    """Step an environment that is no vector as a vector of one, and begin anew where its episode ends."""
    assert_deterministic(lambda: gymnasium.make("CartPole-v1"), STEPS)
    env = gymnasium.make("CartPole-v1")
    found = stepped(env, drawn_actions(env, STEPS, 0), 0)
    assert found["observation"].values.shape == (STEPS + 1, 1, 4)
    assert found["reward"].values.shape == (STEPS, 1)
    assert found["terminated"].values.sum() > 1
    assert found["truncated"].values.dtype == bool


def test_observations_and_actions_of_several_parts() -> None:
    """Name the parts of a dict of observations, and give each environment its part of a dict of actions."""

    class Two(gymnasium.Env):  # type: ignore[misc,name-defined]
        observation_space = gymnasium.spaces.Dict(
            {"arm": gymnasium.spaces.Box(-9, 9, (2,)), "eye": gymnasium.spaces.Box(0, 255, (2, 2), np.uint8)}
        )
        action_space = gymnasium.spaces.Dict({"pull": gymnasium.spaces.Box(-1, 1, (2,))})

        def reset(self, seed: int | None = None, options: Any = None) -> Any:
            super().reset(seed=seed)
            return self.seen(np.zeros(2, np.float32)), {}

        def seen(self, arm: Any) -> Any:
            self.arm = arm
            return {"arm": arm, "eye": self.np_random.integers(0, 255, (2, 2), np.uint8)}

        def step(self, action: Any) -> Any:
            return self.seen(self.arm + action["pull"]), 0.5, bool(self.arm[0] > 1), False, {}

    def make(n: int, mode: str = "SameStep") -> Any:
        return gymnasium.vector.SyncVectorEnv([Two] * n, autoreset_mode=gymnasium.vector.AutoresetMode(mode))

    envs = make(2)
    found = stepped(envs, drawn_actions(envs, STEPS, 1), 1)
    assert found["observation/eye"].values.dtype == np.uint8
    assert found["observation/eye"].values.shape == (STEPS + 1, 2, 2, 2)
    assert found[f"{FINAL}/arm"].values.shape == (STEPS, 2, 2)
    assert found["terminated"].values.any()
    for mode in MODES:
        assert_batch_invariant(lambda n, mode=mode: make(n, mode), steps=STEPS, numbers=(1, 3))
    assert_deterministic(Two, STEPS)


def test_a_vector_that_hides_last_observations() -> None:
    """Refuse a vector that resets in the same step and does not tell what an episode ended with."""

    class Hiding(gymnasium.vector.VectorWrapper):  # type: ignore[misc,name-defined]
        def step(self, actions: Any) -> Any:
            return *self.env.step(actions)[:4], {}

    with pytest.raises(UsageError, match="info has no final_obs"):
        assert_deterministic(lambda: Hiding(carts(3, "SameStep")), STEPS)


@pytest.mark.parametrize("task", ["HalfCheetah-v5", "Ant-v5"])
def test_mujoco_tasks(task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hold tasks on MuJoCo C to the same bits in each run and beside others."""
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)  # where MuJoCo logs that a task's model is old
    assert_deterministic(lambda: gymnasium.make_vec(task, num_envs=2, vectorization_mode="sync"), 40)
    assert_batch_invariant(
        lambda n: gymnasium.make_vec(task, num_envs=n, vectorization_mode="sync"), steps=40, numbers=(1, 3)
    )


def test_a_wrapper_that_mixes_environments() -> None:
    """Find that normalising by the statistics of all environments makes each depend on the others."""
    normalised = gymnasium.wrappers.vector.NormalizeObservation
    text = failure(assert_batch_invariant, lambda n: normalised(carts(n, "NextStep")), steps=20, numbers=(2, 4))
    assert text.startswith("2 envs and the same 2 among 4 differ first at step 0, in env 0: observation[0]: ")


def test_starts_that_come_from_one_generator() -> None:
    """Find that an environment of arrays starts elsewhere among others, as the how-to says; it does repeat itself."""
    assert_deterministic(lambda: gymnasium.make_vec("CartPole-v1", num_envs=2), STEPS)
    text = failure(assert_batch_invariant, lambda n: gymnasium.make_vec("CartPole-v1", num_envs=n), steps=2)
    assert text.startswith("1 env alone and the same env among 16 differ first at step 0: observation[")
