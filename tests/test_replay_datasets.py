"""Data sets in HDF5, made of real steps: what the recordings of them hold, and whether they replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import DamagedRecording, NotARecording, open_recording
from gpusimbench.evaluator.read.episodes import episodes
from gpusimbench.recorder.demonstrations.data_set import Demonstration
from gpusimbench.recorder.demonstrations.hdf5 import made, opened, read
from gpusimbench.recorder.demonstrations.writing import write
from tests.conftest import call
from tests.reading import verified

gymnasium = pytest.importorskip("gymnasium")
h5py = pytest.importorskip("h5py")

_LONGEST = 12
_SEEDS = (2**63 + 5, 7, 2**60 + 1)  # as large as Minari draws them


def demonstrated(task: str) -> tuple[Any, list[Demonstration]]:
    """The specification of a task, and real episodes of it, of drawn actions."""
    env = gymnasium.make(task, max_episode_steps=_LONGEST)
    env.action_space.seed(0)
    found = []
    for seed in _SEEDS:
        seen, done = [env.reset(seed=seed)[0]], False
        actions, rewards, physics = [], [], []
        while not done:
            physics.append((env.unwrapped.data.qpos.copy(), env.unwrapped.data.qvel.copy()))
            actions.append(env.action_space.sample())
            observation, reward, terminated, truncated, _ = env.step(actions[-1])
            seen.append(observation)
            rewards.append(reward)
            done = terminated or truncated
        qpos, qvel = map(np.array, zip(*physics, strict=True))
        found.append(
            Demonstration(
                {"observation": np.array(seen)},
                {"action": np.array(actions)},
                np.array(rewards),
                terminated,
                truncated,
                seed,
                {"qpos": qpos, "qvel": qvel},
            )  # fmt: skip
        )
    env.close()
    return env.spec, found


def flat(path: Path, of: list[Demonstration], dtype: Any, *, physics: bool = True) -> None:
    """Write what D4RL's files hold; without the last observation of an episode, as they are without it."""
    with h5py.File(path, "w") as file:
        file["observations"] = np.concatenate([one.observations["observation"][:-1] for one in of]).astype(dtype)
        file["actions"] = np.concatenate([one.actions["action"] for one in of])
        file["rewards"] = np.concatenate([one.rewards for one in of]).astype(dtype)
        last = np.concatenate([np.arange(len(one)) == len(one) - 1 for one in of])
        file["terminals"] = last & np.repeat([one.terminated for one in of], [len(one) for one in of])
        file["timeouts"] = last & np.repeat([one.truncated for one in of], [len(one) for one in of])
        for name in ("qpos", "qvel") if physics else ():
            file[f"infos/{name}"] = np.concatenate([one.physics[name] for one in of]).astype(dtype)


def grouped(folder: Path, of: list[Demonstration], spec: Any) -> None:
    """Write what Minari's folders hold."""
    (folder / "data").mkdir(parents=True)
    with h5py.File(folder / "data" / "main_data.hdf5", "w") as file:
        for number, one in enumerate(of):
            group = file.create_group(f"episode_{number}")
            group.attrs["seed"] = np.uint64(one.seed)
            group["observations"], group["actions"] = one.observations["observation"], one.actions["action"]
            group["rewards"] = one.rewards
            last = np.arange(len(one)) == len(one) - 1
            group["terminations"], group["truncations"] = last & one.terminated, last & one.truncated
    (folder / "data" / "metadata.json").write_text(json.dumps({"env_spec": spec.to_json()}))


@pytest.mark.parametrize("task", ["Reacher-v5", "Hopper-v5"])
def test_data_sets_replay(task: str, tmp_path: Path) -> None:
    """Replay from recorded states, or from recorded seeds, bit for bit; the recordings are whole."""
    spec, of = demonstrated(task)
    flat(tmp_path / "flat.hdf5", of, np.float64)
    grouped(tmp_path / "grouped-v0", of, spec)
    longest = ("--set", f"max_episode_steps={_LONGEST}")
    shown = call("gsb-replay", "flat.hdf5", "--env", task, *longest, code=0, cwd=tmp_path).stdout
    assert "All 3 episodes replay bit for bit." in shown
    shown = call("gsb-replay", "grouped-v0", code=0, cwd=tmp_path).stdout  # which names its task
    assert "All 3 episodes replay bit for bit." in shown
    for name in ("flat", "grouped-v0"):
        recording = verified(tmp_path / f"{name}.mcap")
        for there, one in zip(episodes(recording), of, strict=True):
            assert (there.terminated, there.truncated) == (one.terminated, one.truncated)
            assert (there.rewards == one.rewards).all() and (there.actions["action"] == one.actions["action"]).all()
            assert there.final_known == (name == "grouped-v0")
            known = len(one) + there.final_known
            assert (there.observations["observation"][:known] == one.observations["observation"][:known]).all()
    arrays = [open_recording(tmp_path / name) for name in ("grouped-v0.mcap", "grouped-v0-replay.mcap")]
    first, second = (one.state("env", "final_observation")[:] for one in arrays)
    steps = min(len(one) for one in of) + 1
    assert (first[:steps] == second[:steps]).all()  # rows are those of wrap
    seeded = call("gsb-replay", "grouped-v0-replay.mcap", code=0, cwd=tmp_path).stdout  # which has the seeds, too
    assert "All 3 episodes replay bit for bit." in seeded
    again = call("gsb-replay", "flat.hdf5", "--env", task, code=2, cwd=tmp_path).stderr
    assert "flat.mcap exists: give it instead" in again
    call("gsb-replay", "flat.mcap", *longest, "--out", "again.mcap", code=0, cwd=tmp_path)


def test_single_precision_is_not_the_state(tmp_path: Path) -> None:
    """Compare in float32 what a data set rounded to that: the start is near, and not the same."""
    _, of = demonstrated("Reacher-v5")
    flat(tmp_path / "a.hdf5", of, np.float32)
    flat(tmp_path / "b.hdf5", of, np.float32, physics=False)
    given = ("--env", "Reacher-v5", "--set", f"max_episode_steps={_LONGEST}", "--json", "-")
    done = call("gsb-replay", "a.hdf5", *given, "--require", "same-outcome", code=0, cwd=tmp_path)
    found = json.loads(done.stdout)
    assert {one["verdict"] for one in found["episodes"]} <= {"same outcome", "bit-identical"}
    assert set(found["episodes"][0]["rounded"]) == {"observation", "reward"}
    assert max(one["largest"]["distance"] for one in found["episodes"]) < 1e-3
    lost = json.loads(call("gsb-replay", "b.hdf5", *given, "--episodes", 2, code=4, cwd=tmp_path).stdout)
    assert (len(lost["episodes"]), lost["began_otherwise"]) == (2, 2)  # neither seed nor state is known
    assert lost["settings"] == []  # the format has a version, and the data set tells no keywords
    flat(tmp_path / "c.hdf5", of, np.float32, physics=False)
    module = ("--env", "gymnasium.envs.mujoco:Reacher-v5", *given[2:])  # of which Gymnasium's id says nothing
    lost = json.loads(call("gsb-replay", "c.hdf5", *module, "--episodes", 2, code=4, cwd=tmp_path).stdout)
    assert lost["settings"] == []
    assert (
        "the data set does not say which versions and which machine made it; a difference there may be the reason"
        in lost["warnings"]
    )


def test_more_episodes_than_environments(tmp_path: Path) -> None:
    """Deal 40 episodes of different lengths to 16 environments, in their order."""
    rng = np.random.default_rng(0)
    of = []
    for number in range(40):
        n = int(rng.integers(1, 6))
        seen = {"observation/at": rng.random((n + 1, 2)), "observation/flag": rng.random(n + 1) < 0.5}
        actions = {"action": rng.integers(9, size=n)}
        of.append(Demonstration(seen, actions, rng.random(n), number % 3 == 0, number % 3 == 1, number, {}))
    (tmp_path / "source.h5").write_bytes(b"of these")
    write(of, tmp_path / "a.mcap", opened(tmp_path / "source.h5"), spec_id="Task-v0", keywords={}, dt=0.1)
    recording = verified(tmp_path / "a.mcap")
    there = {one.env + 16 * one.number: one for one in episodes(recording)}
    assert sorted(there) == list(range(40))
    for number, one in enumerate(of):
        assert (there[number].actions["action"][:, 0] == one.actions["action"]).all()
        assert (there[number].observations["observation_at"] == one.observations["observation/at"]).all()
        assert (there[number].terminated, there[number].truncated) == (one.terminated, one.truncated)
    assert json.loads(recording.attachment("episode_seeds.json") or b"")[3] == [3, 19, 35]


def test_files_that_are_none(tmp_path: Path) -> None:
    """Refuse what is no HDF5, lacks arrays, contradicts itself, or points into other files."""
    path = tmp_path / "a.h5"
    path.write_bytes(b"not HDF5")
    with pytest.raises(NotARecording, match="no HDF5 file"):
        read(path)
    arrays = {"rewards": np.ones(4), "observations": np.ones((4, 2)), "actions": np.ones((4, 1))}
    whole = tmp_path / "whole.h5"
    with h5py.File(whole, "w") as file:
        for name, array in arrays.items():
            file[name] = array
    assert [len(one) for one in read(whole)] == [4]
    for name in arrays:
        for case in ("none", "short", "text", "elsewhere"):
            with h5py.File(path, "w") as file:
                for other, array in arrays.items():
                    if other != name:
                        file[other] = array
                if case == "short":
                    file[name] = arrays[name][:3]
                elif case == "text":
                    file[name] = ["a"] * 4
                elif case == "elsewhere":
                    file[name] = h5py.ExternalLink(str(whole), name)
            with pytest.raises(DamagedRecording):
                read(path)
    with h5py.File(path, "w") as file:
        file.create_group("episode_0")
    with pytest.raises(DamagedRecording, match="has no rewards"):
        read(path)
    with h5py.File(path, "w") as file:
        file["data/demo_0/actions"] = np.ones((4, 1))
    with pytest.raises(DamagedRecording, match="in a layout that is not read: it has data in place of D4RL's arrays"):
        read(path)
    for spec in ("[1]", '{"id": "A-v0", "max_episode_steps": Infinity}'):
        (tmp_path / "metadata.json").write_text(json.dumps({"env_spec": spec}))
        assert made(tmp_path / "main_data.hdf5").spec_id == ""


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("rewards", np.zeros(0), "has no episodes"),
        ("actions", np.zeros((4, 0)), "whose actions have no numbers"),
        ("actions", h5py.SoftLink("/rewards"), "actions is a link"),
        ("terminals/there", np.zeros(4), "terminals is a group"),
        ("episode_0/rewards", np.zeros((5, 2)), "rewards have the shape"),
        ("episode_0/observations/nothing/here", np.zeros((6, 0)), "whose observations have no numbers"),
        ("episode_0", "abc", "the seed of episode_0 is no integer"),
        ("episode_0", [1, 2], "the seed of episode_0 is no integer"),
        ("episode_0", -3, "the seed of episode_0 is no integer"),
        ("bytes", 9, "is damaged, get it again"),
    ],
)
def test_what_no_data_set_has(tmp_path: Path, name: str, value: Any, said: str) -> None:
    """Say in a sentence what is wrong with an array, a link, a seed, or with bytes of the file."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        group = file.create_group("episode_0") if name.startswith("episode_0") else file
        flags = ("terminations", "truncations") if group.name != "/" else ("timeouts",)
        group["observations" + ("/seen" if "nothing" in name else "")] = np.ones((len(flags) + 3, 2))
        for other, array in {
            "rewards": np.ones(4),
            "actions": np.ones((4, 1)),
            **dict.fromkeys(flags, np.ones(4)),
        }.items():
            group[other] = array
        if name == "episode_0":
            group.attrs["seed"] = value
        elif name != "bytes":
            if name in file:
                del file[name]
            file[name] = value
    if name == "bytes":
        path.write_bytes(path.read_bytes().replace(b"TREE", b"tree"))
    with pytest.raises(DamagedRecording, match=said):
        read(path)


def test_what_to_give(tmp_path: Path) -> None:
    """Name the formats where a file is of none, and of the options that name a task the one that data sets take."""
    np.savez(tmp_path / "demos.npz", actions=np.ones(3))
    other = call("gsb-replay", "demos.npz", code=3, cwd=tmp_path).stderr
    assert (
        "demos.npz is not an MCAP file; gsb-replay takes a recording (.mcap) of gpusimbench.wrap, file of D4RL" in other
    )
    with h5py.File(tmp_path / "demos.hdf5", "w") as file:
        file["rewards"] = np.ones(4)
    unnamed = call("gsb-replay", "demos.hdf5", code=2, cwd=tmp_path).stderr
    assert unnamed.strip().endswith("names no environment of Gymnasium's registry: give --env")
