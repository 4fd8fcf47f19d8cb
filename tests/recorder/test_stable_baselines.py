"""Stable-Baselines3 under gpusimbench.wrap: what a VecEnv returns, what is recorded of it, and a whole training run."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import UsageError, open_recording, verify, wrap
from gpusimbench.evaluator.read.episodes import episodes
from tests.conftest import call
from tests.test_docs import FENCE, shows

pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed: make test-training installs it")

import gymnasium
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize

ROOT = Path(__file__).resolve().parents[2]
N_ENV, STEPS, LONGEST = 3, 60, 12


def made(kind: Any = DummyVecEnv, task: str = "CartPole-v1") -> Any:
    """Environments whose episodes end in both ways: by falling, or by their time limit."""
    return make_vec_env(task, n_envs=N_ENV, vec_env_cls=kind, env_kwargs={"max_episode_steps": LONGEST})


def actions(space: Any) -> list[Any]:
    """What is done in each step, the same for all kinds of environments."""
    space.seed(5)
    return [np.array([space.sample() for _ in range(N_ENV)]) for _ in range(STEPS)]


def stepped(envs: Any) -> list[Any]:
    """What a VecEnv returns, from a seeded reset on."""
    envs.seed(7)
    told = [envs.reset()]
    for action in actions(envs.action_space):
        told.append(envs.step(action))
    envs.close()
    return told


@pytest.mark.parametrize("kind", [DummyVecEnv, SubprocVecEnv])
def test_a_vec_env_returns_the_same_and_is_recorded(kind: Any, tmp_path: Path) -> None:
    """Return what the VecEnv returns, and record what Gymnasium's own vector records with the same seed and actions."""
    plain = stepped(made())
    envs = wrap(made(kind), tmp_path / "a.mcap", steps=STEPS, infos=("episode/r", "episode/l"))
    told = stepped(envs)
    assert (told[0] == plain[0]).all()
    for (seen, reward, done, infos), (seen_, reward_, done_, infos_) in zip(told[1:], plain[1:], strict=True):
        assert (seen == seen_).all() and (reward == reward_).all() and (done == done_).all()
        for info, info_ in zip(infos, infos_, strict=True):
            assert info.keys() == info_.keys() and info["TimeLimit.truncated"] == info_["TimeLimit.truncated"]
            assert (info.get("terminal_observation", 0) == np.asarray(info_.get("terminal_observation", 0))).all()

    mode = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}
    longest = {"max_episode_steps": LONGEST}
    other = gymnasium.make_vec("CartPole-v1", num_envs=N_ENV, vectorization_mode="sync", vector_kwargs=mode, **longest)
    other = wrap(other, tmp_path / "b.mcap", steps=STEPS)
    other.reset(seed=7)
    for action in actions(other.single_action_space):
        other.step(action)
    other.close()

    a, b = (open_recording(tmp_path / f"{name}.mcap") for name in "ab")
    verify(a)
    names = {one.field for one in b.fields}
    assert {one.field for one in a.fields} - names == {
        f"info_episode_{name}{end}" for name in "rl" for end in ("", "_given")
    }
    ends = {name: b.state("env", name)[:] != 0 for name in ("terminated", "truncated")}
    both = ends["terminated"] & ends["truncated"]
    assert both.any()  # where a VecEnv does not say that the time was over, too
    assert ((a.state("env", "truncated")[:] != 0) == (ends["truncated"] & ~both)).all()
    for name in names - {"truncated"}:
        assert (a.state("env", name)[:] == b.state("env", name)[:]).all(), name
    assert (a.configuration.seed, a.configuration.scene, a.configuration.dt) == (7, "CartPole-v1", 0.02)
    ended = [one for one in episodes(a) if one.terminated or one.truncated]
    assert {one.terminated for one in ended} == {True, False}
    given = a.state("env", "info_episode_r_given")[:] != 0
    returns = a.state("env", "info_episode_r")[:][given]
    lengths = a.state("env", "info_episode_l")[:][given]
    assert sorted(returns) == sorted(float(one.rewards.sum()) for one in ended)
    assert sorted(lengths) == sorted(len(one.rewards) for one in ended)


def test_wrappers_around_and_within(tmp_path: Path) -> None:
    """Record beneath a wrapper that scales what the policy sees: what is recorded is the task's."""
    plain = stepped(made())
    outer = VecNormalize(wrap(made(), tmp_path / "a.mcap", steps=STEPS))
    told = stepped(outer)
    assert not np.allclose(told[1][0], plain[1][0])
    there = open_recording(tmp_path / "a.mcap").state("env", "observation")[:]
    assert (there[:, :, 0] == np.array([plain[0], *(one[0] for one in plain[1:])])).all()


def test_a_recording_replays(tmp_path: Path) -> None:
    """Make the task again that a VecEnv was of, and find every episode the same; from recorded states, too."""
    envs = wrap(made(task="Reacher-v5"), tmp_path / "a.mcap", steps=STEPS, physics=True)
    stepped(envs)
    found = json.loads(call("gsb-replay", "a.mcap", "--json", "-", code=0, cwd=tmp_path).stdout)
    assert len(found["episodes"]) == N_ENV * STEPS // LONGEST
    assert {one["verdict"] for one in found["episodes"]} == {"bit-identical"}


def test_what_cannot_be_recorded(tmp_path: Path) -> None:
    """Refuse physics of a task that has none, before a step is made."""
    with pytest.raises(UsageError, match="physics is recorded of Gymnasium's MuJoCo tasks"):
        wrap(made(), tmp_path / "a.mcap", steps=STEPS, physics=True)
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize(
    ("line", "cause", "where", "same"),
    [
        (
            "        buffer = self.model.rollout_buffer\n",
            "        np.random.seed()\n",
            "at update 0 of batch",
            "optimizer, policy, rollout, the actions and all that the simulator returned are the same",
        ),
        (
            "        return True\n",
            "        torch.seed()\n",
            r"at step [2-6] \(0\.\d+ s\) in env/action",  # 8 actions of two kinds are the same once in 256 steps
            "optimizer, policy and all that the simulator returned are the same",
        ),
    ],
    ids=["order-of-samples", "sampled-actions"],
)
def test_the_cause_is_named(line: str, cause: str, where: str, same: str, tmp_path: Path) -> None:
    """Lose a seed on the way, and find what differs first, and what is the same until then."""
    text = (ROOT / "examples" / "ppo" / "train.py").read_text(encoding="utf-8")
    assert text.count(line) == 1
    (tmp_path / "train.py").write_text(text.replace(line, cause + line), encoding="utf-8")
    options = ("--json", "found.json", "--", sys.executable, "train.py", "--updates", "1", "--seed", "3")
    said = " ".join(call("gsb-run", *options, cwd=tmp_path, code=4).stdout.split())
    assert re.search(f"Run 0 and run 1 first differ {where}", said), said
    assert same in said.partition(" program ")[0]
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["verdict"] == "different" and found["all_compared"]


def test_the_page(tmp_path: Path) -> None:
    """Do what the page says, in the Python of these tests, and see what it shows."""
    page = (ROOT / "docs" / "how-to" / "is-my-training-reproducible.md").read_text(encoding="utf-8")
    text = page.partition("## With Stable-Baselines3\n")[2].partition("\n## ")[0]
    (tmp_path / "train.py").write_bytes((ROOT / "examples" / "ppo" / "train.py").read_bytes())
    printed, n_command = "", 0
    for language, _, block in FENCE.findall(text):
        if not language:  # what is printed, which other tests of the documents cannot print
            assert shows(block, printed), f"the page shows\n{block}\nnot\n{printed}"
        for line in block.splitlines() if language == "sh" else ():
            words, _, code = line.partition("  # exit code ")
            name, *given = shlex.split(words)
            if name.startswith("gsb-"):
                given = [re.sub(r"^python\b", sys.executable, word) for word in given]
                # whether two threads add in another order than one is the processor's
                done = call(name, *given, cwd=tmp_path, code=None if name == "gsb-diff" else int(code or 0))
                if name == "gsb-diff" and done.returncode == 0:
                    return
                printed, n_command = done.stdout, n_command + 1
    assert n_command == 4
