"""One command at a time in a folder."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
from pathlib import Path

import pytest

from gpusimbench.schemas.commands.folder_lock import folder_lock
from gpusimbench.schemas.errors import GsbError


def test_a_lock_is_held_once_and_leaves_nothing(tmp_path: Path) -> None:
    """Make the folder, name the holder to whoever comes second, and remove the lock at the end."""
    folder = tmp_path / "a" / "b"
    lock = folder / ".sweep.lock"
    for _ in range(2):
        with folder_lock(folder, "sweep", "makes this sweep"):
            assert json.loads(lock.read_text()) == {"pid": os.getpid(), "host": socket.gethostname()}
            said = f"process {os.getpid()} on '{socket.gethostname()}' makes this sweep in .* already"
            with pytest.raises(GsbError, match=said), folder_lock(folder, "sweep", "makes this sweep"):
                pass
            with folder_lock(folder, "other", "makes another"):
                pass
            assert os.listdir(folder) == [".sweep.lock"]
        assert os.listdir(folder) == []


@pytest.mark.parametrize("word", [b"", b"[]", b'{"pid": "x", "host": "y"}', b'{"pid": 1}', b"\xff", b"7"])
def test_a_holder_that_did_not_say_who_it_is(tmp_path: Path, word: bytes) -> None:
    """Refuse all the same, whatever stands in the file."""
    with folder_lock(tmp_path, "sweep", "makes this sweep"):
        (tmp_path / ".sweep.lock").write_bytes(word)
        with (
            pytest.raises(GsbError, match="^another process makes"),
            folder_lock(tmp_path, "sweep", "makes this sweep"),
        ):
            pass


def test_what_a_crash_left_is_no_lock(tmp_path: Path) -> None:
    """Take a lock whose file is there and whose holder is not."""
    (tmp_path / ".sweep.lock").write_text('{"pid": 1, "host": "elsewhere and longer than this machine\'s name"}')
    with folder_lock(tmp_path, "sweep", "makes this sweep"):
        assert json.loads((tmp_path / ".sweep.lock").read_text())["pid"] == os.getpid()


@pytest.mark.parametrize(
    ("number", "held_anyway"), [(errno.ENOLCK, True), (errno.EOPNOTSUPP, True), (errno.EIO, False)]
)
def test_file_systems_without_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: int, held_anyway: bool
) -> None:
    """Warn where there are no locks, and go on; end where there should be."""

    def fail(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", fail)
    if held_anyway:
        with folder_lock(tmp_path, "sweep", "makes this sweep"):
            assert "a file system without locks" in capsys.readouterr().err
        assert os.listdir(tmp_path) == []
    else:
        with pytest.raises(GsbError, match="cannot lock"), folder_lock(tmp_path, "sweep", "makes this sweep"):
            pass


@pytest.mark.parametrize("replaced", [False, True])
def test_a_lock_whose_file_is_removed_as_it_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, replaced: bool
) -> None:
    """Lock the file that is there, where a holder ends between the opening and the locking of its file."""
    path, flock, locked = tmp_path / ".sweep.lock", fcntl.flock, []

    def late(descriptor: int, operation: int) -> None:
        if not locked:
            path.unlink()
            if replaced:
                path.touch()
        locked.append(descriptor)
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with folder_lock(tmp_path, "sweep", "makes this sweep"):
        assert len(locked) == 2
        assert json.loads(path.read_text())["pid"] == os.getpid()
        with pytest.raises(GsbError, match="already"), folder_lock(tmp_path, "sweep", "makes this sweep"):
            pass
    assert os.listdir(tmp_path) == []


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    """Say so, and what to do, where a file has its name."""
    (tmp_path / "file").touch()
    with pytest.raises(GsbError, match="cannot make .*choose another folder"), folder_lock(tmp_path / "file", "a", "b"):
        pass
