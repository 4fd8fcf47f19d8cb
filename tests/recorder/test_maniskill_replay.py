"""Trajectories that ManiSkill wrote, replayed in ManiSkill: the states of every step."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mani_skill")

import h5py

from gpusimbench import UsageError, open_recording
from gpusimbench.evaluator.diff.brief import place_of
from gpusimbench.evaluator.replays.verdict import EpisodeVerdict
from tests.maniskill_tasks import SEEDS, STEPS, TASK, record
from tests.replaying import replayed, replayed_recording

pytestmark = pytest.mark.filterwarnings("ignore")  # of ManiSkill, which calls numpy as it was


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, where recordings of data sets are written."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def seeded(file: Path, *seeds: int | None) -> None:
    """Write other seeds into the metadata."""
    beside = file.with_suffix(".json")
    told = json.loads(beside.read_text())
    for one, seed in zip(told["episodes"], seeds, strict=True):
        one["reset_kwargs"]["seed"] = one["episode_seed"] = seed
    beside.write_text(json.dumps(told))


@pytest.mark.parametrize("mode", ["pd_joint_delta_pos", "pd_joint_target_delta_pos"])
@pytest.mark.parametrize("seeds", [SEEDS, (90, None, 92)])
def test_trajectories_replay(mode: str, seeds: tuple[int | None, ...], here: Path) -> None:
    """Replay bit for bit, by the recorded seeds, or, where others lead elsewhere, by the recorded states."""
    file = record(here / "demos", mode)
    seeded(file, *seeds)
    found = replayed(file, env=TASK)
    assert [one.verdict for one in found.episodes] == [EpisodeVerdict.IDENTICAL] * 3
    assert {one.steps for one in found.episodes} == {(STEPS, STEPS)} and found.began_otherwise == 0
    original = open_recording("trajectory.mcap")
    with h5py.File(file) as groups:
        cube = np.concatenate([groups[f"traj_{number}/env_states/actors/cube"][:-1] for number in range(3)])
        succeeded = [bool(groups[f"traj_{number}/success"][-1]) for number in range(3)]
    assert (original.state("env", "observation_actors_cube")[:-1, 0, 0] == cube).all()
    assert np.ptp(cube[:, 2]) > 0.01  # it fell, or was moved
    assert [one.success for one in found.episodes] == [(flag, flag) for flag in succeeded]
    again = replayed_recording(Path("replay.mcap"), Path("again.mcap"), env=TASK)  # which has seeds and states, too
    assert [one.verdict for one in again.episodes] == [EpisodeVerdict.IDENTICAL] * 3


def test_another_step_of_physics_is_found(here: Path) -> None:
    """Say at which step the states of a replay leave those of the file, and that they began as recorded."""
    found = replayed(record(here / "demos"), 'sim_config={"sim_freq": 200}', env=TASK)
    assert found.count(EpisodeVerdict.IDENTICAL) == 0 and found.began_otherwise == 0
    for one in found.episodes:
        assert one.first is not None and one.first.step == 1 and one.largest is not None
        assert one.largest.distance > 1e-3


def test_a_changed_state_is_another(here: Path) -> None:
    """Name the step and the body where a file has another state than the one that its actions lead to."""
    file = record(here / "demos")
    with h5py.File(file, "r+") as groups:
        cube = groups["traj_1/env_states/actors/cube"]
        row = cube[7]
        row[1] = np.nextafter(row[1], np.float32(2))
        cube[7] = row
    found = replayed(file, env=TASK)
    assert [one.verdict for one in found.episodes] == [
        EpisodeVerdict.IDENTICAL,
        EpisodeVerdict.SAME,
        EpisodeVerdict.IDENTICAL,
    ]
    first = found.episodes[1].first
    assert first is not None and (first.step, place_of(first.number)) == (7, "observation_actors_cube[1]")


def test_files_without_states_are_refused(here: Path) -> None:
    """Say by which option of RecordEpisode the file would have them."""
    with pytest.raises(UsageError, match="has no env_states: RecordEpisode writes them with record_env_state=True"):
        replayed(record(here / "demos", record_env_state=False), env=TASK)
