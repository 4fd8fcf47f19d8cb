"""Demonstrations that robosuite's own tools wrote, replayed in robosuite: the states of every step.

No environment of the project has robosuite 1.5.2, which needs an older MuJoCo (3.3.7) than the project's.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("robosuite")

import h5py
import robosuite

from gpusimbench import GsbError, open_recording
from gpusimbench.evaluator.replays.verdict import EpisodeVerdict
from tests.replaying import replayed, replayed_recording

pytestmark = pytest.mark.filterwarnings("ignore")  # of robosuite, which leaves files open
CONFIGURATION = {"env_name": "Lift", "robots": "Panda", "control_freq": 20}
STEPS = 85


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two lifted cubes, by robosuite's wrapper that collects demonstrations, and its script that gathers them."""
    from robosuite.scripts.collect_human_demonstrations import gather_demonstrations_as_hdf5
    from robosuite.wrappers import DataCollectionWrapper

    folder = tmp_path_factory.mktemp("robosuite")
    env = robosuite.make(
        **CONFIGURATION, has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False, ignore_done=True
    )
    env = DataCollectionWrapper(env, str(folder / "raw"))
    for _ in range(2):
        env.reset()
        seen = env.env._get_observations(force_update=True)
        for step in range(STEPS):
            seen, *_ = env.step(lifting(seen, step))
    env.close()
    gather_demonstrations_as_hdf5(str(folder / "raw"), str(folder), json.dumps(CONFIGURATION))
    return folder / "demo.hdf5"


def lifting(seen: Any, step: int) -> Any:
    """Above the cube, down to it, fingers closed, and up."""
    action = np.zeros(7)
    action[6] = -1 if step < 50 else 1
    if step < 50:
        to = seen["cube_pos"] - seen["robot0_eef_pos"] + np.array([0, 0, 0.05 if step < 30 else 0])
        action[:3] = np.clip(10 * to, -1, 1)
    elif step >= 60:
        action[2] = 0.6
    return action


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, where recordings of data sets are written."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_demonstrations_replay(collected: Path, here: Path) -> None:
    """Replay bit for bit, each episode in its own model; the recording has the states of the file, and success."""
    found = replayed(collected)
    assert [one.verdict for one in found.episodes] == [EpisodeVerdict.IDENTICAL] * 2
    assert [one.success for one in found.episodes] == [(True, True)] * 2
    recording = open_recording("demo.mcap")
    assert recording.configuration.dt == 0.05
    with h5py.File(collected) as file:
        qpos = np.concatenate([file[f"data/demo_{number}/states"][:, 1:17] for number in (1, 2)])
    assert (recording.state("env", "observation_qpos")[:-1, 0, 0] == qpos).all()
    again = replayed_recording(Path("replay.mcap"), Path("again.mcap"))  # which has states and models, too
    assert [one.verdict for one in again.episodes] == [EpisodeVerdict.IDENTICAL] * 2


def test_another_time_step_is_another_outcome(collected: Path, here: Path) -> None:
    """Say that a cube is no longer lifted with actions of half the duration."""
    found = replayed(collected, "control_freq=40")
    assert {one.verdict for one in found.episodes} == {EpisodeVerdict.OTHER}
    assert all(one.success == (True, False) and one.began_alike for one in found.episodes)


def test_the_model_of_an_episode_decides(collected: Path, here: Path) -> None:
    """Replay in the model of the file: in a denser medium, the same actions lead to other states."""
    shutil.copy(collected, here / "dense.hdf5")
    with h5py.File("dense.hdf5", "r+") as file:
        demo = file["data/demo_1"]
        model = demo.attrs["model_file"]
        demo.attrs["model_file"] = changed = model.replace('density="1.2"', 'density="900"', 1)
        assert changed != model
    found = replayed(here / "dense.hdf5")
    assert [one.verdict is EpisodeVerdict.IDENTICAL for one in found.episodes] == [False, True]


def test_a_model_with_other_files_is_refused(collected: Path, here: Path) -> None:
    """Open no file that is not robosuite's."""
    shutil.copy(collected, here / "other.hdf5")
    with h5py.File("other.hdf5", "r+") as file:
        demo = file["data/demo_1"]
        demo.attrs["model_file"] = demo.attrs["model_file"].replace("<asset>", '<asset><mesh file="/etc/a.stl"/>', 1)
    with pytest.raises(GsbError, match=r"names a file that is not robosuite's: /etc/a\.stl"):
        replayed(here / "other.hdf5")
