"""Demonstrations in the layouts of robosuite and robomimic: what is read of them, and what is refused."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gpusimbench import DamagedRecording, UsageError, open_recording
from gpusimbench.evaluator.read.episodes import episodes
from gpusimbench.recorder.demonstrations.formats import data_set_at
from gpusimbench.recorder.demonstrations.writing import write
from gpusimbench.replay.parts import parts_of
from gpusimbench.schemas.vector import MODELS
from tests.conftest import call
from tests.reading import verified
from tests.test_replay_maniskill import found_at

gymnasium = pytest.importorskip("gymnasium")
h5py = pytest.importorskip("h5py")

from gpusimbench.recorder.vector.robosuite import own_files_only, without_entities  # noqa: E402  needs Gymnasium

NQ, NV = 16, 15
LENGTHS = (4, 6)
MODEL = "<mujoco><worldbody><body/></worldbody></mujoco>"
ARGUMENTS = {"env_name": "Lift", "type": 1, "env_version": "1.5.1", "env_kwargs": {"robots": "Panda"}}


def space(nq: int = NQ) -> Any:
    """Of observations of a task with such a model."""
    sizes = {"time": 1, "qpos": nq, "qvel": NV}
    return gymnasium.spaces.Dict({name: gymnasium.spaces.Box(-np.inf, np.inf, (n,)) for name, n in sizes.items()})


def written(path: Path, *, collected: bool = False, change: Callable[[Any], None] = lambda file: None) -> Path:
    """Two demonstrations, changed; as robosuite's script has them (collected), or robomimic."""
    rng = np.random.default_rng(1)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        if collected:
            data.attrs["env"], data.attrs["repository_version"] = "Lift", "1.5.2"
            data.attrs["env_info"] = json.dumps({"env_name": "Lift", "robots": "Panda"})
        else:
            data.attrs["env_args"] = json.dumps(ARGUMENTS)
        for number, length in zip((10, 9), LENGTHS, strict=True):  # in the order of numbers, and not of letters
            demo = data.create_group(f"demo_{number}")
            demo["states"] = rng.standard_normal((length, 1 + NQ + NV))
            demo["actions"] = rng.standard_normal((length, 7))
            demo.attrs["model_file"] = MODEL
            if not collected:
                demo.attrs["num_samples"] = length
                demo["rewards"], demo["dones"] = np.arange(length) / 10, np.arange(length) == length - 1
        change(data)
    return path


@pytest.mark.parametrize("collected", [False, True])
def test_what_is_read(collected: bool, tmp_path: Path) -> None:
    """Read states by their parts, actions, rewards, models, and how the environment was made."""
    source = found_at(written(tmp_path / "a.hdf5", collected=collected))
    assert (source.made.spec_id, source.made.keywords) == ("Lift", {"robots": "Panda"})
    assert source.version == ("robosuite 1.5.2" if collected else "robosuite 1.5.1")
    assert [len(one) for one in source.read(1, space())] == [LENGTHS[1]]
    write(source.read(None, space()), tmp_path / "a.mcap", source, spec_id="Lift", keywords={}, dt=0.05)
    recording = verified(tmp_path / "a.mcap")
    (parts,) = parts_of(recording)
    with h5py.File(tmp_path / "a.hdf5") as file:
        for number, one, part in zip((9, 10), episodes(recording), parts, strict=True):
            demo = file[f"data/demo_{number}"]
            states = np.concatenate([one.observations[f"observation_{name}"] for name in ("time", "qpos", "qvel")], 1)
            assert (states[:-1] == demo["states"][:]).all() and not one.final_known
            assert (part.actions["action"] == demo["actions"][:]).all() and part.model == MODEL
            assert part.state is not None and (part.state["observation_qpos"] == demo["states"][0, 1 : 1 + NQ]).all()
            assert one.rewarded != collected
            assert collected or (one.rewards == demo["rewards"][:]).all()
    if collected:  # the script keeps what succeeded, and does not say at which step
        success, given = (recording.state("env", f"info_success{end}")[:, 0, 0, 0] for end in ("", "_given"))
        last = np.isin(np.arange(len(given)), np.cumsum(LENGTHS[::-1]))
        assert (success == last).all() and (given == last).all()


def test_a_version_that_is_none(tmp_path: Path) -> None:
    """Name no version where what stands there cannot be written into a recording."""
    told = json.dumps({**ARGUMENTS, "env_version": "\ud800"})
    source = found_at(written(tmp_path / "a.hdf5", change=lambda data: data.attrs.update(env_args=told)))
    assert source.version == "robosuite"
    write(source.read(None, space()), tmp_path / "a.mcap", source, spec_id="Lift", keywords={}, dt=0.05)


def _without(name: str) -> Callable[[Any], None]:
    return lambda data: data["demo_9"].attrs.__delitem__(name)


def _other(name: str, value: Any) -> Callable[[Any], None]:
    def change(data: Any) -> None:
        del data[f"demo_9/{name}"]
        data[f"demo_9/{name}"] = value

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_without("model_file"), "demo_9 has no model_file"),
        (_other("states", np.ones((5, 1 + NQ + NV))), "demo_9 is not whole: it has 5 states and 6 actions"),
        (lambda data: data["demo_9"].attrs.update(num_samples=7), "demo_9 is not whole"),
        (_other("states", np.full((6, 1 + NQ + NV), np.nan)), "a state of demo_9 is not finite"),
        (_other("states", np.ones((6, 30))), "states of demo_9 have 30 numbers, and the model of the task 32"),
        (_other("states", np.ones(6)), "states of demo_9 have 1 numbers"),
        (_other("actions", np.ones((0, 7))), "demo_9 is not whole"),
        (_other("rewards", np.ones((6, 2))), "rewards have the shape"),
        (lambda data: data.attrs.update(env_args="{"), "what it says of its environment is no JSON"),
        (lambda data: data.attrs.update(env_args="[1]"), "what it says of its environment is no JSON"),
        (lambda data: data.attrs.update(env_args='[["env_name", "x"]]'), "what it says of its environment is no JSON"),
        (lambda data: data.attrs.update(env_args='{"env_kwargs": [[1, 2]]}'), "what it says of its environment is no"),
        (lambda data: [data.__delitem__(name) for name in list(data)], "has no episodes"),
    ],
)
def test_files_that_cannot_be(change: Callable[[Any], None], said: str, tmp_path: Path) -> None:
    """Say in a sentence what is wrong with a file."""
    with pytest.raises(DamagedRecording, match=said):
        found_at(written(tmp_path / "a.hdf5", change=change)).read(None, space())


@pytest.mark.parametrize(("number", "size"), [(1, 2**64 - 16), (1, 2**20), (0, 0)])
def test_texts_that_would_be_read_for_ever(number: int, size: int, tmp_path: Path) -> None:
    """Refuse a file in which an object of a heap has a size with which HDF5's library does not come to its end."""
    file = written(tmp_path / "a.hdf5")
    whole = bytearray(file.read_bytes())
    at = whole.index(b"GCOL") + 16
    whole[at : at + 2], whole[at + 8 : at + 16] = number.to_bytes(2, "little"), size.to_bytes(8, "little")
    file.write_bytes(whole)
    with pytest.raises(DamagedRecording, match="a heap of texts has other sizes"):
        data_set_at(file)


def test_models_in_a_recording_that_cannot_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse models that are not packed as they are written, or too long."""
    source = found_at(written(tmp_path / "a.hdf5"))
    write(source.read(None, space()), tmp_path / "a.mcap", source, spec_id="Lift", keywords={}, dt=0.05)
    whole = open_recording(tmp_path / "a.mcap")
    good = whole.attachment(MODELS)
    texts = [b"no gzip", good[:-9], *(gzip.compress(text) for text in (b"{", b'{"models": [1], "episodes": [[0]]}'))]
    for packed in texts:
        monkeypatch.setattr(whole, "attachment", lambda name, packed=packed: packed if name == MODELS else None)
        with pytest.raises(DamagedRecording, match="has something else than models"):
            parts_of(whole)


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ('<mujoco><asset><mesh file="/etc/a.stl"/></asset></mujoco>', "names a file that is not robosuite's: /etc/a"),
        ('<mujoco><asset><mesh file="{assets}/../a.stl"/></asset></mujoco>', "names a file that is not robosuite's"),
        ('<mujoco><asset><texture fileleft="a.png"/></asset></mujoco>', "names a file that is not robosuite's: a.png"),
        ('<mujoco><include file="{assets}/a.xml"/></mujoco>', "has the element include, which is not followed"),
        ('<mujoco><extension><plugin plugin="a"/></extension></mujoco>', "has the element extension"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><mujoco/>', "declares entities"),
    ],
)
def test_models_that_name_files(model: str, said: str, tmp_path: Path) -> None:
    """Refuse models that would have MuJoCo open a file which is not robosuite's, or load code."""
    with pytest.raises(UsageError, match=said):
        own_files_only(without_entities(model.format(assets=tmp_path)), tmp_path)


def test_a_model_with_files_of_robosuite(tmp_path: Path) -> None:
    """Take a model whose files lie in robosuite's folder, with comments."""
    model = f'<mujoco><!-- a --><asset><mesh file="{tmp_path}/a.stl"/></asset></mujoco>'
    assert own_files_only(without_entities(model), tmp_path) == model


def test_the_command_needs_robosuite(tmp_path: Path) -> None:
    """Say which package is missing."""
    try:
        import robosuite  # noqa: F401
    except ImportError:
        written(tmp_path / "a.hdf5")
        shown = call("gsb-replay", "a.hdf5", code=2, cwd=tmp_path).stderr
        assert "Lift needs robosuite: pip install robosuite" in shown
    else:
        pytest.skip("robosuite is installed here: tests/recorder/test_robosuite_replay.py replays")
