"""Folders of runs: gone with the last process of a run, whoever was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from gpusimbench.recorder.process import scratch
from tests.conftest import command


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files of this process and those that it starts."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


def age(path: Path) -> None:
    """Make a folder, or a link itself, an hour old."""
    then = time.time() - 3600
    os.utime(path, (then, then), follow_symlinks=False)


def test_a_folder_is_removed_when_its_run_is_over(temporary: Path) -> None:
    """Leave nothing, also where the run's process removed the folder before."""
    with scratch.scratch_folder() as (folder, output):
        output.write(b"x")
        assert folder.parent == temporary
    with scratch.scratch_folder() as (folder, _):
        (folder / scratch.OUTPUT).unlink()
        folder.rmdir()
    assert list(temporary.iterdir()) == []


def test_a_folder_in_use_stays(temporary: Path) -> None:
    """Leave a folder while its recorder, or a process that inherited its output, is there; remove it afterwards."""
    with scratch.scratch_folder() as (folder, output):
        age(folder)
        scratch.remove_abandoned()
        assert folder.is_dir()
        held = ("import sys; sys.stdin.read()",)
        child = subprocess.Popen([sys.executable, "-c", *held], stdin=subprocess.PIPE, stdout=output)
        output.close()
        scratch.remove_abandoned()
        assert folder.is_dir()
        child.communicate()
        age(folder)
        scratch.remove_abandoned()
        assert not folder.exists()


def test_what_is_not_known_to_be_abandoned_stays(temporary: Path) -> None:
    """Leave a young folder, a folder without the file, a link, and folders of others."""
    young, bare, other = (temporary / name for name in ("gsb-run-young", "gsb-run-bare", "others"))
    for folder in (young, bare, other):
        folder.mkdir()
    for folder in (young, other):
        (folder / scratch.OUTPUT).touch()
    (temporary / "gsb-run-link").symlink_to(other)
    for path in (bare, other, temporary / "gsb-run-link"):
        age(path)
    scratch.remove_abandoned()
    assert {path.name for path in temporary.iterdir()} == {"gsb-run-young", "gsb-run-bare", "gsb-run-link", "others"}
    assert (other / scratch.OUTPUT).exists()


def test_a_later_run_removes_what_killed_ones_left(tmp_path: Path, temporary: Path) -> None:
    """Remove, with the next run, the folder of a run that was killed together with its recorder."""
    arguments = ("--sim", "mujoco", "--phases", "capture", "--n-env", "1", "--steps", "5000000", "--stride", "5000000")
    record = [*command("gsb-record"), *arguments, "--out", str(tmp_path / "out")]
    recorder = subprocess.Popen(record, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    children = Path(f"/proc/{recorder.pid}/task/{recorder.pid}/children")
    while not (child := children.read_text().split()):
        time.sleep(0.01)
    recorder.kill()
    os.kill(int(child[0]), signal.SIGKILL)
    recorder.communicate()
    (left,) = temporary.glob("gsb-run-*")
    age(left)
    deadline = time.monotonic() + 60
    while left.exists() and time.monotonic() < deadline:  # the killed process may hold its lock for a moment
        with scratch.scratch_folder() as (folder, _):
            assert folder.is_dir()
    assert list(temporary.glob("gsb-run-*")) == []
