"""Trajectories in the layout of ManiSkill: what is read of them, and what is refused. ManiSkill is not needed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import DamagedRecording, UsageError
from gpusimbench.evaluator.read.episodes import episodes
from gpusimbench.recorder.demonstrations.data_set import DataSet
from gpusimbench.recorder.demonstrations.formats import data_set_at
from gpusimbench.recorder.demonstrations.writing import write
from gpusimbench.replay.parts import parts_of
from tests.conftest import call
from tests.reading import verified

pytest.importorskip("gymnasium")
h5py = pytest.importorskip("h5py")

LENGTHS = (4, 6)


def written(folder: Path, change: Callable[[Any], None] = lambda told: None) -> Path:
    """Two trajectories, their metadata changed; returns the file in HDF5."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    told: dict[str, Any] = {
        "env_info": {
            "env_id": "PickCube-v1",
            "env_kwargs": {"obs_mode": "none", "sim_backend": "physx_cpu"},
            "max_episode_steps": 50,
        },
        "commit_info": None,
        "episodes": [],
    }
    with h5py.File(folder / "trajectory.h5", "w") as file:
        for number, length in enumerate(LENGTHS):
            group = file.create_group(f"traj_{number}")
            group["actions"] = rng.standard_normal((length, 8), np.float32)
            group["env_states/actors/cube"] = rng.standard_normal((length + 1, 13), np.float32)
            group["env_states/articulations/panda"] = rng.standard_normal((length + 1, 31), np.float32)
            group["success"] = group["terminated"] = np.arange(length) > 2
            group["truncated"] = np.zeros(length, bool)
            group["rewards"] = rng.standard_normal(length, np.float32)
            told["episodes"].append(
                {
                    "episode_id": number,
                    "episode_seed": 7 + number,
                    "control_mode": "pd_joint_delta_pos",
                    "elapsed_steps": length,
                    "reset_kwargs": {"options": {}, "seed": 7 + number},
                }
            )
    change(told)
    (folder / "trajectory.json").write_text(json.dumps(told))
    return folder / "trajectory.h5"


def found_at(path: Path) -> DataSet:
    """The data set at a path."""
    found = data_set_at(path)
    assert found is not None
    return found


def test_what_is_read(tmp_path: Path) -> None:
    """Read actions, states, rewards, success and seeds, and how the environment was made, from a file or its folder."""
    file = written(tmp_path / "a")
    source = found_at(file)
    assert source.path == found_at(file.parent).path and source.files == (file, file.with_suffix(".json"))
    assert source.made.spec_id == "PickCube-v1"
    assert source.made.keywords == {
        "obs_mode": "none", "sim_backend": "physx_cpu", "control_mode": "pd_joint_delta_pos", "max_episode_steps": 50,
    }  # fmt: skip
    assert [len(one) for one in source.read(1, None)] == [LENGTHS[0]]
    every = source.read(None, None)
    write(every, tmp_path / "a.mcap", source, spec_id="PickCube-v1", keywords=source.made.keywords, dt=0.05)
    recording = verified(tmp_path / "a.mcap")
    assert recording.configuration.n_env == 1  # which goes through the episodes in their order
    of_file = list(episodes(recording))
    (parts,) = parts_of(recording)
    with h5py.File(file) as groups:
        for number, (one, part) in enumerate(zip(of_file, parts, strict=True)):
            group = groups[f"traj_{number}"]
            for name in ("actors/cube", "articulations/panda"):
                array, states = f"observation_{name.replace('/', '_')}", group[f"env_states/{name}"][:]
                assert (one.observations[array] == states).all() and part.state is not None
                assert (part.state[array] == states[0]).all()
            assert (part.actions["action"] == group["actions"][:]).all()
            assert (one.rewards == group["rewards"][:]).all()
            assert part.seed == 7 + number
            assert (one.terminated, one.truncated, one.final_known) == (False, False, True)
        success = np.concatenate([groups[f"traj_{number}/success"] for number in range(2)])
    assert (recording.state("env", "info_success")[1:, 0, 0, 0] == success).all()


def test_seeds(tmp_path: Path) -> None:
    """Take the seed of the reset, also from a list with one, or else that which ManiSkill drew, if there is any."""

    def change(told: Any) -> None:
        told["episodes"][0]["reset_kwargs"]["seed"] = [5]
        told["episodes"][1]["reset_kwargs"] = {}

    assert [one.seed for one in found_at(written(tmp_path / "a", change)).read(None, None)] == [5, 8]

    def without_drawn(told: Any) -> None:
        change(told)
        for one in told["episodes"]:
            del one["episode_seed"]

    without = written(tmp_path / "b", without_drawn)
    assert [one.seed for one in found_at(without).read(None, None)] == [5, None]


def test_rewards_and_success_may_be_missing(tmp_path: Path) -> None:
    """Read a trajectory that has neither, as of a task without success that was recorded without rewards."""
    file = written(tmp_path / "a")
    with h5py.File(file, "r+") as groups:
        for number in range(2):
            del groups[f"traj_{number}/rewards"], groups[f"traj_{number}/success"]
    for one in found_at(file).read(None, None):
        assert not one.rewarded and not one.infos and (one.rewards == 0).all()


def _first(name: str, value: Any) -> Callable[[Any], None]:
    return lambda told: told["episodes"][0].update({name: value})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_first("episode_id", 5), "has no traj_5"),
        (_first("episode_id", "0/actions"), "episode_id that is no integer"),
        (_first("episode_id", "0\0x"), "episode_id that is no integer"),
        (_first("reset_kwargs", {"seed": -1}), "the seed of traj_0 is no integer of at least 0"),
        (_first("reset_kwargs", {"seed": "../x"}), "the seed of traj_0 is no integer of at least 0"),
        (_first("reset_kwargs", [1]), "traj_0 has no keywords of its reset"),
        (lambda told: told.update(episodes=[]), "has no episodes"),
        (lambda told: told.update(episodes=[1]), "episodes are no list of episodes"),
        (lambda told: told.update(env_info=[1]), "env_info has no keywords of an environment"),
        (lambda told: told["env_info"].update(env_kwargs=3), "env_info has no keywords of an environment"),
    ],
)
def test_metadata_that_cannot_be(change: Callable[[Any], None], said: str, tmp_path: Path) -> None:
    """Say in a sentence what is wrong with the metadata."""
    with pytest.raises(DamagedRecording, match=said):
        found_at(written(tmp_path / "a", change)).read(None, None)


@pytest.mark.parametrize("name", [3, None, "a\nb", "\ud800", "a" * 1000])
def test_what_is_no_name(name: Any, tmp_path: Path) -> None:
    """Take no name of a task from what is no line of text: the user has to name the task."""
    assert found_at(written(tmp_path / "a", lambda told: told["env_info"].update(env_id=name))).made.spec_id == ""


@pytest.mark.parametrize("text", ["{", "[" * 100_000, "\x00"])
def test_metadata_that_are_no_json(text: str, tmp_path: Path) -> None:
    """Say that the metadata cannot be read."""
    file = written(tmp_path / "a")
    file.with_suffix(".json").write_text(text)
    with pytest.raises(DamagedRecording, match=r"trajectory\.json cannot be read"):
        data_set_at(file)


def test_what_is_not_replayed(tmp_path: Path) -> None:
    """Refuse options of resets, several control modes, states without names, and a file whose metadata are missing."""
    options = _first("reset_kwargs", {"options": {"reconfigure": True}})
    with pytest.raises(UsageError, match="was reset with options"):
        found_at(written(tmp_path / "options", options)).read(None, None)
    with pytest.raises(UsageError, match="several control modes"):
        data_set_at(written(tmp_path / "modes", _first("control_mode", "pd_ee_pose")))
    old = written(tmp_path / "old")
    with h5py.File(old, "r+") as groups:
        del groups["traj_0/env_states"]
        groups["traj_0/env_states"] = np.zeros((5, 44), np.float32)
    with pytest.raises(UsageError, match="is of ManiSkill 2"):
        found_at(old).read(None, None)
    old.with_suffix(".json").unlink()
    with pytest.raises(DamagedRecording, match=r"needs its metadata beside it, trajectory\.json"):
        found_at(old).read(None, None)


def test_the_command_needs_maniskill(tmp_path: Path) -> None:
    """Say which package is missing, and that a keyword that may be a path has to be named by the user."""
    if _there():
        pytest.skip("ManiSkill is installed here: tests/recorder/test_maniskill_replay.py replays")
    written(tmp_path / "a")
    shown = call("gsb-replay", "a", code=2, cwd=tmp_path).stderr
    assert "PickCube-v1 needs ManiSkill: pip install mani-skill" in shown
    written(tmp_path / "b", lambda told: told["env_info"]["env_kwargs"].update(robot_uids="/tmp/x.py"))
    shown = call("gsb-replay", "b", code=2, cwd=tmp_path).stderr
    assert "keyword robot_uids" in shown and "may name a file" in shown
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def _there() -> bool:
    try:
        import mani_skill  # noqa: F401
    except ImportError:
        return False
    return True
