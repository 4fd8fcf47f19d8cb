"""Data sets in HDF5 of a stranger: what they must not open, and what they must not cost."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gpusimbench import NotARecording
from tests.test_replay_maniskill import found_at

h5py = pytest.importorskip("h5py")

_SECONDS = 30  # nothing here takes a tenth of that, unless it waits for a writer of a pipe

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
