"""Data sets of LeRobot: those that its library made, the older layout, and folders that are none."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import DamagedRecording, UsageError, open_recording, verify
from gpusimbench.evaluator.read.episodes import episodes
from gpusimbench.recorder.demonstrations.formats import data_set_at
from gpusimbench.recorder.demonstrations.lerobot import opened, read
from tests.conftest import call

gymnasium = pytest.importorskip("gymnasium")
polars = pytest.importorskip("polars")

MADE = Path(__file__).resolve().parents[1] / "recordings" / "lerobot"
REACHER = ("--env", "Reacher-v5", "--set", "max_episode_steps=12")


def frames(folder: Path) -> Any:
    """All frames of a data set."""
    return polars.read_parquet(next((folder / "data").rglob("*.parquet")))


def changed(folder: Path, table: Any = None, **info: Any) -> Path:
    """A copy of the data set of Reacher, with another table, and other values in its metadata."""
    shutil.copytree(MADE / "reach", folder)
    if table is not None:
        table.write_parquet(next((folder / "data").rglob("*.parquet")))
    told = json.loads((folder / "meta" / "info.json").read_text())
    names = set(table.columns) if table is not None else told["features"]
    told["features"] = {name: one for name, one in told["features"].items() if name in names}
    (folder / "meta" / "info.json").write_text(json.dumps({**told, **info}))
    return folder


def test_a_data_set_of_the_library_replays(tmp_path: Path) -> None:
    """Replay bit for bit, from recorded states, what the library wrote; the recording has the numbers of the file."""
    shown = call("gsb-replay", MADE / "reach", *REACHER, code=0, cwd=tmp_path).stdout
    assert "All 3 episodes, as far as recorded, replay bit for bit." in shown
    assert "compared in float32" in shown
    recording, table = open_recording(tmp_path / "reach.mcap"), frames(MADE / "reach")
    verify(recording)
    assert recording.configuration.dt == 0.02
    assert "lerobot v3.0" in call("gsb-info", "reach.mcap", code=0, cwd=tmp_path).stdout
    for one in episodes(recording):
        rows = table.filter(polars.col("episode_index") == one.env)
        assert (one.actions["action"] == rows["action"].to_numpy()).all()
        assert (one.observations["observation"][:-1] == rows["observation.state"].to_numpy()).all()
        assert (one.rewards == rows["next.reward"].to_numpy()).all()
        assert (one.terminated, one.truncated, one.final_known, one.rewarded) == (False, False, False, True)
    done = call("gsb-replay", "reach.mcap", *REACHER, "--out", "again.mcap", code=0, cwd=tmp_path)
    assert "bit for bit" in done.stdout


def test_the_older_layout(tmp_path: Path) -> None:
    """Read a file for each episode, and the first ones alone, as from the file of the newer layout."""
    table = frames(MADE / "reach")
    folder = changed(tmp_path / "old", codebase_version="v2.1", total_episodes=3)
    chunk = folder / "data" / "chunk-000"
    (chunk / "file-000.parquet").unlink()
    for (number,), rows in table.group_by("episode_index"):
        lists = rows.with_columns(polars.col("action").arr.to_list(), polars.col("observation.state").arr.to_list())
        lists.write_parquet(chunk / f"episode_{number:06d}.parquet")
    for most in (None, 2):
        there, here = read(MADE / "reach", most), read(folder, most)
        assert len(here) == (most or 3)
        for one, other in zip(there, here, strict=True):
            assert (one.actions["action"] == other.actions["action"]).all()
            assert (one.observations["observation"] == other.observations["observation"]).all()
            assert (one.physics["qvel"] == other.physics["qvel"]).all() and one.seed == other.seed
    assert [one.seed for one in here] == [7, 2**60 + 1]
    (chunk / "episode_000001.parquet").unlink()
    with pytest.raises(DamagedRecording, match="has 2 of 3 episodes: get the other files"):
        read(folder)


def test_what_can_be_said_without_seed_states_and_rewards(tmp_path: Path) -> None:
    """Name the first observation as another, and no outcome where the file says nothing of it."""
    table = frames(MADE / "reach").drop("seed", "physics.qpos", "physics.qvel", "next.reward")
    folder = changed(tmp_path / "plain", table)
    done = call("gsb-replay", folder, *REACHER, "--json", "-", code=4, cwd=tmp_path)
    found = json.loads(done.stdout)
    assert {one["verdict"] for one in found["episodes"]} == {"outcome not known"}
    assert {tuple(one["returns"]) for one in found["episodes"]} == {(None, None)}
    assert found["began_otherwise"] == 3
    assert "the original has no rewards: returns were not compared" in found["warnings"]
    said = call("gsb-replay", "plain.mcap", "--against", "plain-replay.mcap", code=4, cwd=tmp_path).stdout
    assert (
        "3 of 3 episodes with other bits; the data set has neither rewards nor success, so outcomes are not compared."
        in said
    )
    assert "has no rewards" in call("gsb-episodes", "plain.mcap", code=5, cwd=tmp_path).stderr
    told = json.loads(call("gsb-info", "plain.mcap", "--json", "-", code=0, cwd=tmp_path).stdout)
    assert '"mean_return": null' in json.dumps(told)


def test_arrays_have_the_names_of_the_environment() -> None:
    """Call the state as an environment of several observations does; success is the info of LeRobot's environments."""
    box = gymnasium.spaces.Box(0, 1, (2,))
    names = {
        ("agent_pos", "environment_state"): {"observation/agent_pos", "observation/environment_state"},
        ("state", "environment_state"): {"observation/state", "observation/environment_state"},
    }
    table = frames(MADE / "pusht")
    for keys, expected in names.items():
        first = read(MADE / "pusht", 1, gymnasium.spaces.Dict(dict.fromkeys(keys, box)))[0]
        assert set(first.observations) == expected
    assert (first.infos["is_success"] == table["next.success"].to_numpy()[:12]).all()
    assert first.seed is None and not first.physics
    assert set(read(MADE / "reach", 1)[0].observations) == {"observation"}


def test_a_success_that_no_environment_gives(tmp_path: Path) -> None:
    """Say after the first step that a task has no such info, and leave the recording of the data set alone."""
    table = frames(MADE / "reach").with_columns(polars.lit(True).alias("next.success"))
    folder = changed(tmp_path / "a", table)
    info = json.loads((folder / "meta" / "info.json").read_text())
    info["features"]["next.success"] = {"dtype": "bool", "shape": [1], "names": None}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    done = call("gsb-replay", folder, *REACHER, "--success", "is_success", code=2, cwd=tmp_path)
    assert "the environment gives no info is_success" in done.stderr
    assert [one.name for one in tmp_path.glob("*.mcap*")] == ["a.mcap"]


def _spoiled() -> dict[str, tuple[Any, str]]:
    column = polars.col
    at = polars.int_range(polars.len())
    lists = column("action").arr.to_list()
    return {
        "frame missing": (lambda t: t.filter(at != 5), "frames of episode 0 are missing"),
        "frame twice": (lambda t: polars.concat([t, t[:1]]), "frames of episode 0 are missing"),
        "no column": (lambda t: t.drop("frame_index"), "the frames cannot be read"),
        "null": (lambda t: t.with_columns(polars.when(at != 3).then(column("action"))), "not the same shape"),
        "ragged": (
            lambda t: t.with_columns(polars.when(at < 9).then(lists.list.head(1)).otherwise(lists).alias("action")),
            "not the same shape",
        ),
        "narrow": (lambda t: t.with_columns(lists.list.head(1).alias("action")), "has not the shape of"),
        "text": (lambda t: t.with_columns(polars.lit("a").alias("action")), "something else than numbers"),
        "seed": (lambda t: t.with_columns(column("seed") - 9), "the seed of episode 0 is no integer"),
        "seeds": (lambda t: t.with_columns(column("frame_index").alias("seed")), "the seed of episode 0 is no integer"),
        "no action": (lambda t: t.drop("action"), "has no feature action"),
        "no state": (lambda t: t.drop("observation.state"), "has no feature observation"),
        "empty": (lambda t: t[:0], "has 0 of 3 episodes"),
        "halves": (
            lambda t: t.with_columns(column("episode_index") + 0.5),
            "episode_index has something else than whole",
        ),
        "nan": (lambda t: t.with_columns(polars.lit(float("nan")).alias("episode_index")), "else than whole numbers"),
    }


@pytest.mark.parametrize("case", _spoiled())
def test_frames_that_cannot_be(case: str, tmp_path: Path) -> None:
    """Say in a sentence what is wrong with the frames."""
    spoil, said = _spoiled()[case]
    table = spoil(frames(MADE / "reach"))
    with pytest.raises(DamagedRecording, match=said):
        read(changed(tmp_path / "a", table))


def test_no_episodes(tmp_path: Path) -> None:
    """Say that a data set has no frames, where it claims none, and where its first episodes are asked for."""
    folder = changed(tmp_path / "a", frames(MADE / "reach")[:0], total_episodes=0)
    for most in (None, 1):
        with pytest.raises(DamagedRecording, match="has no frames: its files in data/ have no rows"):
            read(folder, most)


def test_a_folder_named_like_frames(tmp_path: Path) -> None:
    """Read the files of frames, and pass over a folder with such a name; a truth value is no rate of frames."""
    folder = changed(tmp_path / "a", fps=True)
    (folder / "data" / "old.parquet").mkdir()
    assert len(read(folder)) == 3
    found = opened(folder)
    assert found is not None and found.dt is None and all(file.is_file() for file in found.files)


def test_damaged_bytes(tmp_path: Path) -> None:
    """Read the numbers, or say in a sentence that the file is damaged, whichever bytes of it are others."""
    folder = changed(tmp_path / "a")
    file = next((folder / "data").rglob("*.parquet"))
    whole, rng, n_refused = file.read_bytes(), np.random.default_rng(0), 0
    for _ in range(100):
        spoiled = np.frombuffer(whole, np.uint8).copy()
        spoiled[rng.integers(len(whole), size=3)] = rng.integers(256, size=3)
        file.write_bytes(spoiled.tobytes())
        try:
            assert len(read(folder)) == 3
        except DamagedRecording:
            n_refused += 1
    assert n_refused > 50


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ("[1]", "names no features"),
        ("{", "cannot be read"),
        ("[" * 100_000, "cannot be read"),
        ('{"features": {"action": {"dtype": "float32"}}}', "the feature action has no dtype and shape"),
        ('{"features": {"action": {"dtype": "float32", "shape": [-1]}}}', "the feature action has no dtype and shape"),
        ('{"features": {"action": {"dtype": "float32", "shape": [1e9]}}}', "more numbers than are read at once"),
        ('{"features": {"action": {"dtype": 1, "shape": [2]}}}', "the feature action has no dtype and shape"),
        ('{"features": {"nothing": {"dtype": "float32", "shape": [2]}}}', "has no feature action"),
    ],
)
def test_metadata_that_cannot_be(told: str, said: str, tmp_path: Path) -> None:
    """Say in a sentence what is wrong with the metadata."""
    folder = changed(tmp_path / "a")
    (folder / "meta" / "info.json").write_text(told)
    with pytest.raises(DamagedRecording, match=said):
        read(folder)


def test_other_folders(tmp_path: Path) -> None:
    """Refuse another version, files that are no Parquet, a folder without frames, and one of no format."""
    with pytest.raises(UsageError, match=r"of version v1\.6: v2\.0, v2\.1, v3\.0 are read"):
        opened(changed(tmp_path / "new", codebase_version="v1.6"))
    folder = changed(tmp_path / "a")
    file = folder / "data" / "chunk-000" / "file-000.parquet"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(DamagedRecording, match="the frames cannot be read"):
        read(folder)
    file.unlink()
    with pytest.raises(DamagedRecording, match="has no frames"):
        read(folder)
    with pytest.raises(UsageError, match="is a folder without main_data.hdf5"):
        data_set_at(tmp_path)
    assert data_set_at(tmp_path / "none.mcap") is None
    assert np.isclose(data_set_at(MADE / "pusht").dt, 0.1)  # type: ignore[union-attr,arg-type]
