"""Data sets in HDF5 of a stranger: what they must not open, and what they must not cost."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gpusimbench import DamagedRecording, NotARecording
from gpusimbench.schemas.provenance import MAX_FIELDS
from tests.hostile.reading import in_time
from tests.test_replay_maniskill import found_at, written

h5py = pytest.importorskip("h5py")

_SECONDS = 300  # nothing here takes a hundredth of that, unless it waits for a writer of a pipe

_READ = """
import sys
from pathlib import Path
from gpusimbench.recorder.demonstrations.hdf5 import read
from gpusimbench.schemas.errors import DamagedRecording

for name in sys.argv[1:]:
    try:
        read(Path(name))
    except DamagedRecording as error:
        print(error)
"""


def test_no_other_file_is_opened(tmp_path: Path) -> None:
    """Refuse a link to another file without opening it: h5py would wait for ever for the writer of a pipe."""
    os.mkfifo(tmp_path / "pipe")
    for name, place in (("flat", "/"), ("minari", "/episode_0")):
        with h5py.File(tmp_path / f"{name}.hdf5", "w") as file:
            group = file.require_group(place)
            for array in ("rewards", "terminations", "truncations"):
                group[array] = np.zeros(4)
            group["observations"], group["actions"] = np.zeros((5 if place != "/" else 4, 2)), np.zeros((4, 2))
            group["infos"] = h5py.ExternalLink(str(tmp_path / "pipe"), "/")
    files = [str(tmp_path / f"{name}.hdf5") for name in ("flat", "minari")]
    said = subprocess.run(
        [sys.executable, "-c", _READ, *files], capture_output=True, text=True, check=True, timeout=_SECONDS
    ).stdout
    assert said == "".join(f"{file}: infos/qpos is a link, and none is followed\n" for file in files)


def test_what_is_no_file(tmp_path: Path) -> None:
    """Refuse a pipe with the name of a data set, also behind a link, without waiting for its writer."""
    os.mkfifo(tmp_path / "pipe.h5")
    (tmp_path / "link.hdf5").symlink_to(tmp_path / "pipe.h5")
    writer = os.open(tmp_path / "pipe.h5", os.O_RDWR)  # so that whoever opens the pipe does not wait
    try:
        for name in ("pipe.h5", "link.hdf5"):
            with pytest.raises(NotARecording, match=f"{name} is not a file"):
                found_at(tmp_path / name).read(None, None)
    finally:
        os.close(writer)


@pytest.mark.parametrize("length", [1, 3])
def test_infos_of_another_length(length: int, tmp_path: Path) -> None:
    """Refuse success of fewer steps than the episode has; of one, it stood for all steps."""
    file = written(tmp_path / "a")
    with h5py.File(file, "r+") as groups:
        del groups["traj_0/success"]
        groups["traj_0/success"] = np.ones(length, bool)
    with pytest.raises(DamagedRecording, match=rf"success of an episode of 4 steps has the shape \({length},\)"):
        found_at(file).read(None, None)


@pytest.mark.parametrize("member", ["actions", "env_states/actors/cube"])
def test_arrays_that_were_never_written(member: str, tmp_path: Path) -> None:
    """Refuse an array of gigabytes in a file of kilobytes, before memory is taken for it."""
    file = written(tmp_path / "a")
    with h5py.File(file, "r+") as groups:
        del groups[f"traj_0/{member}"]
        groups.create_dataset(f"traj_0/{member}", (4, 200_000_000), np.float32, chunks=(1, 1_000_000))
    with pytest.raises(DamagedRecording, match="has 3200000000 bytes, most of which were never"):
        found_at(file).read(None, None)


def test_zeros_that_were_packed(tmp_path: Path) -> None:
    """Read an array that packs as well as any does: zeros."""
    file = written(tmp_path / "a")
    with h5py.File(file, "r+") as groups:
        del groups["traj_0/env_states/actors/cube"]
        zeros = np.zeros((5, 1 << 20), np.float32)  # 20 MiB
        array = groups.create_dataset(
            "traj_0/env_states/actors/cube", data=zeros, compression="gzip", chunks=(1, 1 << 20)
        )
        assert array.id.get_storage_size() < zeros.nbytes // 900
    observations = found_at(file).read(1, None)[0].observations
    assert observations["observation/actors/cube"].shape == zeros.shape


def test_groups_without_end(tmp_path: Path) -> None:
    """Refuse groups that have several names, of which a small file can make any number of paths, and a cycle."""
    file = written(tmp_path / "a")
    with h5py.File(file, "r+") as groups:
        group = groups["traj_0/env_states/actors"]
        for _ in range(6):
            inner = group.create_group("0")
            for name in range(1, 40):
                group[str(name)] = inner
            group = inner
    with in_time(), pytest.raises(DamagedRecording, match="1 is there under another name, too"):
        found_at(file).read(None, None)
    cycle = written(tmp_path / "b")
    with h5py.File(cycle, "r+") as groups:
        groups["traj_0/env_states/actors/again"] = groups["traj_0/env_states"]
    with pytest.raises(DamagedRecording, match="again is there under another name, too"):
        found_at(cycle).read(None, None)


def test_more_arrays_than_a_recording_has(tmp_path: Path) -> None:
    """Refuse states of more arrays than are read of a recording, and say so before one is written."""
    file = written(tmp_path / "a")
    with h5py.File(file, "r+") as groups:
        for number in range(MAX_FIELDS - 1):
            groups[f"traj_0/env_states/{number}"] = np.zeros((5, 1), np.float32)
    with pytest.raises(DamagedRecording, match=f"observation has more than {MAX_FIELDS} arrays"):
        found_at(file).read(None, None)
