"""Environments of Isaac Lab in gpusimbench.wrap: a task on PhysX, its resets, and its last observations."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("isaaclab")
pytest.importorskip("ovphysx")
pytest.importorskip("gymnasium", reason="environments of Isaac Lab are those of Gymnasium, which is not installed")

import torch

from gpusimbench import open_recording, wrap
from gpusimbench.evaluator.diff import compare
from gpusimbench.evaluator.read.episodes import episodes
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.simulators.isaaclab.simulator import _without_pinned_memory
from tests.reading import verified

pytestmark = pytest.mark.filterwarnings("ignore::FutureWarning", "ignore::DeprecationWarning", "ignore::UserWarning")

N_ENV, LONGEST, STEPS = 3, 8, 30
FAR = 0.2  # [m]
WORKFLOWS = pytest.mark.parametrize("workflow", ["direct", "managed"])


@cache
def tasks() -> dict[str, Any]:
    """Class and configuration of a task in both of Isaac Lab's workflows: cubes are pushed over a table, and an episode
    ends where one has come far."""
    import isaaclab.sim as sim
    from isaaclab.assets import AssetBaseCfg, RigidObjectCfg
    from isaaclab.envs import DirectRLEnv, DirectRLEnvCfg, ManagerBasedRLEnv, ManagerBasedRLEnvCfg
    from isaaclab.managers import (
        ActionTerm,
        ActionTermCfg,
        EventTermCfg,
        ObservationGroupCfg,
        ObservationTermCfg,
        RewardTermCfg,
        TerminationTermCfg,
    )
    from isaaclab.scene import InteractiveSceneCfg
    from isaaclab.sim import SimulationCfg
    from isaaclab.sim.schemas import MassCfg, UsdPhysicsCollisionCfg, UsdPhysicsRigidBodyCfg
    from isaaclab.utils import configclass
    from isaaclab_ov.physics import OvPhysxCfg

    collides = [UsdPhysicsCollisionCfg()]
    block = sim.CuboidCfg(
        size=(0.1,) * 3,
        collision_props=collides,
        rigid_props=[UsdPhysicsRigidBodyCfg()],
        mass_props=[MassCfg(mass=1.0)],
    )
    board = sim.CuboidCfg(size=(3.0, 3.0, 0.2), collision_props=collides)

    @configclass
    class PushingScene(InteractiveSceneCfg):
        table = AssetBaseCfg(
            prim_path="{ENV_REGEX_NS}/table", spawn=board, init_state=AssetBaseCfg.InitialStateCfg(pos=(0.0, 0.0, -0.1))
        )
        cube = RigidObjectCfg(
            prim_path="{ENV_REGEX_NS}/cube",
            spawn=block,
            init_state=RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 0.05), rot=(0.0, 0.0, 0.0, 1.0)),
        )

    @configclass
    class PushingCfg(DirectRLEnvCfg):
        decimation = 2
        episode_length_s = LONGEST * 0.02
        action_space, observation_space = 2, 3
        sim = SimulationCfg(dt=0.01, render_interval=2, device="cpu", save_logs_to_file=False, physics=OvPhysxCfg())
        scene = PushingScene(num_envs=N_ENV, env_spacing=4.0)
        seed = 5

    def place(env: Any) -> Any:
        return env.scene["cube"].data.root_link_pose_w.torch[:, :3] - env.scene.env_origins

    def push(env: Any, actions: Any) -> None:
        velocity = env.scene["cube"].data.root_com_vel_w.torch.clone()
        velocity[:, :2] += actions
        env.scene["cube"].write_root_com_velocity_to_sim_index(root_velocity=velocity)

    def begin(env: Any, env_ids: Any) -> None:
        every = isinstance(env_ids, slice)
        at = torch.arange(N_ENV) if every else torch.as_tensor(env_ids, dtype=torch.long)
        pose = torch.zeros((len(at), 7))
        pose[:, :3] = env.scene.env_origins[at] + torch.tensor([0.0, 0.0, 0.05])
        pose[:, :2] += 0.01 * torch.rand((len(at), 2))
        pose[:, 6] = 1.0
        some = {"env_ids": at.to(torch.int32)}
        env.scene["cube"].write_root_link_pose_to_sim_index(root_pose=pose, **some)
        env.scene["cube"].write_root_com_velocity_to_sim_index(root_velocity=torch.zeros((len(at), 6)), **some)

    class Pushing(DirectRLEnv):  # type: ignore[misc]
        def _pre_physics_step(self, actions: Any) -> None:
            push(self, actions)

        def _apply_action(self) -> None:
            pass

        def _get_observations(self) -> Any:
            return {"policy": place(self).clone()}

        def _get_rewards(self) -> Any:
            return place(self)[:, 0].clone()

        def _get_dones(self) -> Any:
            return place(self)[:, 0] > FAR, self.episode_length_buf >= self.max_episode_length

        def _reset_idx(self, env_ids: Any) -> None:
            super()._reset_idx(env_ids)
            begin(self, env_ids)

    class Push(ActionTerm):  # type: ignore[misc]
        action_dim = 2
        raw_actions = processed_actions = property(lambda self: self._given)
        _given = torch.zeros((N_ENV, 2))

        def process_actions(self, actions: Any) -> None:
            self._given = actions.clone()
            push(self._env, actions)

        def apply_actions(self) -> None:
            pass

    @configclass
    class Policy(ObservationGroupCfg):
        place = ObservationTermCfg(func=lambda env: place(env).clone())

    @configclass
    class Observations:
        policy = Policy()

    @configclass
    class Actions:
        push = ActionTermCfg(class_type=Push, asset_name="cube")

    @configclass
    class Rewards:
        place = RewardTermCfg(func=lambda env: place(env)[:, 0].clone(), weight=1.0)

    @configclass
    class Terminations:
        far = TerminationTermCfg(func=lambda env: place(env)[:, 0] > FAR)
        late = TerminationTermCfg(func=lambda env: env.episode_length_buf >= env.max_episode_length, time_out=True)

    @configclass
    class Events:
        put_back = EventTermCfg(func=begin, mode="reset")

    @configclass
    class ManagedCfg(ManagerBasedRLEnvCfg):
        decimation = 2
        episode_length_s = LONGEST * 0.02
        sim = PushingCfg().sim
        scene = PushingScene(num_envs=N_ENV, env_spacing=4.0)
        seed = 5
        observations, actions, rewards = Observations(), Actions(), Rewards()
        terminations, events = Terminations(), Events()

    return {"direct": (Pushing, PushingCfg), "managed": (ManagerBasedRLEnv, ManagedCfg)}


def pushed(path: Path, workflow: str, *, final: bool = False) -> list[Any]:
    """Record steps of the task; returns what it returned."""
    _without_pinned_memory()
    kind, configuration = tasks()[workflow]
    cfg = configuration()
    cfg.compute_final_obs = final
    with wrap(kind(cfg), path, steps=STEPS) as envs:
        told = [(envs.reset(seed=7)[0]["policy"].clone(),)]
        generator = torch.Generator().manual_seed(1)
        for _ in range(STEPS):
            action = torch.rand((N_ENV, 2), generator=generator) * 2 - 0.5
            observation, reward, terminated, truncated, info = envs.step(action)
            last = info["final_obs"]["policy"].clone() if final and (terminated | truncated).any() else None
            told.append(
                (observation["policy"].clone(), reward.clone(), terminated.clone(), truncated.clone(), action, last)
            )
    return told


def column(recording: Recording, name: str) -> Any:
    """An array, [row, env] or [row, env, number]."""
    return recording.state("env", name)[:, :, 0].squeeze(-1 if recording.state("env", name).shape[-1] == 1 else ())


@WORKFLOWS
def test_a_task_of_isaac_lab_is_recorded(workflow: str, tmp_path: Path) -> None:
    """Record what step returned, in every bit, and the ends of episodes; the same again in another recording."""
    told = pushed(tmp_path / "a.mcap", workflow)
    recording = verified(tmp_path / "a.mcap")
    assert (recording.status, recording.configuration.simulator, recording.configuration.dt) == (
        "complete", "isaaclab", 0.02,
    )  # fmt: skip
    assert np.array_equal(column(recording, "observation_policy"), np.stack([row[0] for row in told]))
    for name, at in (("reward", 1), ("terminated", 2), ("truncated", 3), ("action", 4)):
        assert np.array_equal(column(recording, name)[1:], np.stack([row[at] for row in told[1:]])), name
    ended = np.stack([row[2] | row[3] for row in told[1:]])
    assert np.array_equal(column(recording, "final_observation_given")[1:], ~ended)
    assert all(column(recording, name).any() for name in ("terminated", "truncated"))
    assert sum(map(len, episodes(recording))) == STEPS * N_ENV
    pushed(tmp_path / "b.mcap", workflow)
    assert compare.compare(recording, open_recording(tmp_path / "b.mcap")).bit_identical


@WORKFLOWS
def test_last_observations_where_the_task_tells_them(workflow: str, tmp_path: Path) -> None:
    """Record them where the configuration has compute_final_obs."""
    told = pushed(tmp_path / "a.mcap", workflow, final=True)
    recording = verified(tmp_path / "a.mcap")
    seen, final = (column(recording, name) for name in ("observation_policy", "final_observation_policy"))
    ends = 0
    for row, (_, _, terminated, truncated, _, last) in enumerate(told[1:], start=1):
        done = (terminated | truncated).numpy()
        assert np.array_equal(final[row][~done], seen[row][~done])
        if done.any():
            ends += int(done.sum())
            assert np.array_equal(final[row][done], last.numpy()[done] if len(last) == N_ENV else last.numpy())
            assert (final[row][done] != seen[row][done]).any()
    assert ends > N_ENV
    assert all(one.final_known for one in episodes(recording))
