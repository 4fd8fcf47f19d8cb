"""ManiSkill's vector environment in gpusimbench.wrap: tensors of torch, rows on their device."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mani_skill")

import gymnasium
import torch

from gpusimbench import UsageError, open_recording, wrap
from gpusimbench.evaluator.read.episodes import Episode, episodes
from gpusimbench.evaluator.read.recording import Recording
from tests.reading import verified

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of what ManiSkill imports for rendering and training
    from mani_skill.envs.tasks.empty_env import EmptyEnv
    from mani_skill.utils.registration import register_env
    from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv

pytestmark = pytest.mark.filterwarnings("ignore")  # of ManiSkill, which calls numpy as it was
LONGEST = 7


@register_env("GsbReaching-v1", max_episode_steps=LONGEST)
class Reaching(EmptyEnv):  # type: ignore[misc]
    """A Panda in ManiSkill's scene without a renderer: it succeeds where its first joint has turned to one side."""

    def evaluate(self) -> Any:
        turned = self.agent.robot.get_qpos()[:, 0]
        return {"success": turned > 0.1, "turned": turned}

    def compute_dense_reward(self, obs: Any, action: Any, info: Any) -> Any:
        return info["turned"]

    SUPPORTED_REWARD_MODES = ("dense",)


def reaching(**options: Any) -> Any:
    """One of them as ManiSkill trains with it; more need a GPU."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = gymnasium.make(
            "GsbReaching-v1", num_envs=1, obs_mode="state_dict", sim_backend="cpu", render_backend="none",
            reward_mode="dense",
        )  # fmt: skip
        return ManiSkillVectorEnv(env, **options)


def drawn(steps: int) -> list[Any]:
    """Actions [env, 8] that turn the first joint more to the one side than to the other."""
    generator = torch.Generator().manual_seed(0)
    return [torch.rand((1, 8), generator=generator) * 2 - 0.7 for _ in range(steps)]


def column(recording: Recording, name: str) -> Any:
    """An array of environments, [row, env, width]."""
    return recording.state("env", name)[:, :, 0]


def joints(episode: Episode) -> Any:
    """Positions of the joints in an episode, its last observation included, [step + 1, 9]."""
    return episode.observations["observation_agent_qpos"]


@pytest.mark.parametrize("steps", [20, 60])
def test_a_recording_has_what_the_bare_environment_returns(steps: int, tmp_path: Path) -> None:
    """Return what the environment returns, bit for bit, and record it, with the observations that resets replaced."""
    bare, recorded = reaching(), wrap(reaching(), tmp_path / "a.mcap", steps=steps, infos=("success", "turned", "no"))
    assert isinstance(recorded, gymnasium.vector.VectorEnv)
    assert (recorded.num_envs, recorded.device, recorded.base_env.num_envs) == (1, torch.device("cpu"), 1)
    bare.reset(seed=5)
    recorded.reset(seed=5)
    found: dict[str, list[Any]] = {name: [] for name in ("reward", "turned", "terminated", "truncated", "seen", "last")}
    for action in drawn(steps):
        one, other = bare.step(action), recorded.step(action)
        for a, b in zip(one[:4], other[:4], strict=True):
            assert (
                torch.equal(a, b)
                if torch.is_tensor(a)
                else all(map(torch.equal, a["agent"].values(), b["agent"].values()))
            )
        observation, reward, terminated, truncated, info = one
        last, of_step = info.get("final_observation", observation), info.get("final_info", info)
        told = (reward, of_step["turned"], terminated, truncated, observation["agent"]["qpos"], last["agent"]["qpos"])
        for name, value in zip(found, told, strict=True):
            found[name].append(np.array(value))
    recorded.close()
    bare.close()
    recording = verified(tmp_path / "a.mcap")
    assert recording.status == "complete"
    for name, field in (
        ("reward", "reward"), ("turned", "info_turned"), ("seen", "observation_agent_qpos"),
        ("last", "final_observation_agent_qpos"), ("terminated", "terminated"), ("truncated", "truncated"),
    ):  # fmt: skip
        expected = np.stack(found[name]).reshape(steps, 1, -1)
        assert np.array_equal(column(recording, field)[1:], expected), field
    assert np.array_equal(column(recording, "info_success")[1:], column(recording, "terminated")[1:])
    assert not column(recording, "info_no_given").any() and column(recording, "info_success_given")[1:].all()
    every = list(episodes(recording))
    assert any(one.terminated for one in every) and all(len(one) <= LONGEST for one in every)
    for one in every:
        assert one.final_known
        assert one.terminated == (joints(one)[-1, 0] > np.float32(0.1))
    c = recording.configuration
    assert (c.simulator, c.scene, c.dt, c.seed) == ("mani_skill", "GsbReaching-v1", 0.05, 5)
    assert c.options["autoreset_mode"] == "SameStep"


def test_resets_of_the_user(tmp_path: Path) -> None:
    """Begin episodes where the user resets, without automatic resets; an action of one may lack its axis."""
    with wrap(reaching(auto_reset=False), tmp_path / "a.mcap", steps=30, dt=0.1) as recorded:
        observation, _ = recorded.reset(seed=1)
        begins, lasts = [np.array(observation["agent"]["qpos"][0])], []
        for action in drawn(30):
            observation, _, terminated, truncated, _ = recorded.step(action[0].numpy())
            if (terminated | truncated).any():
                lasts.append(np.array(observation["agent"]["qpos"][0]))
                observation, _ = recorded.reset(options={"env_idx": torch.tensor([0])})
                begins.append(np.array(observation["agent"]["qpos"][0]))
    recording = verified(tmp_path / "a.mcap")
    assert (recording.configuration.options["autoreset_mode"], recording.configuration.dt) == ("Disabled", 0.1)
    every = list(episodes(recording))
    assert len(lasts) > 3
    for number, last in enumerate(lasts):
        assert every[number].ended
        assert np.array_equal(joints(every[number])[0], begins[number])
        assert np.array_equal(joints(every[number])[-1], last)


def test_how_a_recording_ends(tmp_path: Path) -> None:
    """Failed where steps are missing; whole with hashes; refused where it cannot be."""
    with wrap(reaching(), tmp_path / "short.mcap", steps=9) as short:
        short.reset()
        short.fingerprint("policy", torch.arange(3))
        short.step(drawn(1)[0])
    assert (verified(tmp_path / "short.mcap").status, open_recording(tmp_path / "short.mcap").reason) == (
        "failed", "states end at step 1 of 9",
    )  # fmt: skip
    with pytest.raises(UsageError, match="physics is recorded of MuJoCo's environments"):
        wrap(reaching(), tmp_path / "a.mcap", steps=9, physics=True)
    with pytest.raises(UsageError, match="is reset before it is stepped"):
        wrap(reaching(), tmp_path / "a.mcap", steps=9).step(drawn(1)[0])
    assert [path.name for path in tmp_path.iterdir()] == ["short.mcap"]
