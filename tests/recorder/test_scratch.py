"""Folders of runs: gone with the last process of a run, whoever was killed."""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from io import FileIO
from pathlib import Path

import pytest

from gpusimbench import open_recording
from gpusimbench.schemas import scratch
from gpusimbench.schemas.errors import GsbError
from gpusimbench.schemas.mcap.reader import Container
from gpusimbench.schemas.provenance import ENGINE_LOG
from tests.conftest import command, wait_for
from tests.recorder.conftest import folder_of


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for temporary files of this process and those that it starts."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    return folder


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
        scratch.remove_abandoned()
        assert folder.is_dir()
        held = ("import sys; sys.stdin.read()",)
        child = subprocess.Popen([sys.executable, "-c", *held], stdin=subprocess.PIPE, stdout=output)
        output.close()
        scratch.remove_abandoned()
        assert folder.is_dir()
        child.communicate()
        scratch.remove_abandoned()
        assert not folder.exists()


def test_what_is_not_known_to_be_abandoned_stays(temporary: Path) -> None:
    """Leave a folder without the file, a link, folders of others, and those of machines whose locks may not be seen."""
    with scratch.scratch_folder() as (folder, _):
        machine = folder.name.rpartition("-")[0]
    bare, other, elsewhere = (temporary / name for name in (f"{machine}-bare", "others", "gsb-work-0-elsewhere"))
    link, abandoned = temporary / f"{machine}-link", temporary / f"{machine}-abandoned"
    for made in (bare, other, elsewhere, abandoned):
        made.mkdir()
    for made in (other, elsewhere, abandoned):
        (made / scratch.OUTPUT).touch()
    link.symlink_to(other)
    scratch.remove_abandoned()
    assert {*temporary.iterdir()} == {bare, other, elsewhere, link}
    assert (other / scratch.OUTPUT).exists()


def test_a_folder_of_before_a_restart_is_known(temporary: Path) -> None:
    """Name folders by the machine and not by its boot: no process has a lock of an earlier boot."""
    with scratch.scratch_folder() as (folder, _):
        assert folder.parent == temporary
        assert Path("/proc/sys/kernel/random/boot_id").read_text()[:8] not in folder.name


def test_no_other_run_takes_a_folder_that_is_not_locked_yet(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave it also where it seems old: a process can be stopped for long, and a file server has a clock of its own."""
    lock = fcntl.flock

    def lock_late(output: FileIO, how: int) -> None:
        (folder,) = temporary.iterdir()
        os.utime(folder, (0, 0))
        monkeypatch.setattr(fcntl, "flock", lock)
        scratch.remove_abandoned()
        lock(output, how)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    with scratch.scratch_folder() as (folder, _):
        assert (folder / scratch.OUTPUT).exists()


def test_a_later_run_removes_what_killed_ones_left(tmp_path: Path, temporary: Path) -> None:
    """Remove, with the next run, the folder of a run that was killed together with its recorder."""
    arguments = ("--sim", "mujoco", "--phases", "capture", "--n-env", "1", "--steps", "5000000", "--stride", "5000000")
    record = [*command("gsb-record"), *arguments, "--out", str(tmp_path / "out")]
    recorder = subprocess.Popen(record, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    children = Path(f"/proc/{recorder.pid}/task/{recorder.pid}/children")
    wait_for(lambda: children.read_text() != "")
    (child,) = children.read_text().split()
    recorder.kill()
    os.kill(int(child), signal.SIGKILL)
    recorder.communicate()
    (left,) = temporary.glob("gsb-work-*")

    def removed() -> bool:
        with scratch.scratch_folder() as (folder, _):
            assert folder.is_dir()
        return not left.exists()

    wait_for(removed)  # the killed process may hold its lock for a moment
    assert list(temporary.glob("gsb-work-*")) == []


_KEPT = """
import os, signal
from pathlib import Path
from unittest import mock
{imports}
def killed(*given, **more):
    os.kill(os.getpid(), signal.SIGKILL)
with mock.patch({where!r}, killed):
    {call}
"""


@pytest.mark.parametrize(
    ("imports", "where", "call"),
    [
        ("from gpusimbench.recorder.scenes.model import compiled", "mujoco.MjModel.from_xml_path", "compiled(model)"),
        (
            "from gpusimbench.evaluator.read.addresses import fetched\nfrom gpusimbench.schemas.location import place",
            "gpusimbench.evaluator.read.addresses.write_pieces", "fetched(place('memory://held.mcap')).__enter__()",
        ),
    ],
    ids=["model", "copy"],
)  # fmt: skip
def test_what_a_killed_process_left_is_removed(
    temporary: Path, tmp_path: Path, imports: str, where: str, call: str
) -> None:
    """Remove, with the next folder, that of a model's files or of a copy, whose process was killed while it used it."""
    model = tmp_path / "robot.xml"
    model.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    given = (
        "import fsspec; fsspec.filesystem('memory').pipe('held.mcap', b'x' * 9)\n"
        f"from gpusimbench.schemas.model_files import pack\nmodel = pack(Path({str(model)!r}))\n{imports}"
    )
    program = _KEPT.format(imports=given, where=where, call=call)
    done = subprocess.run([sys.executable, "-c", program], stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert len([*temporary.iterdir()]) == 1
    with scratch.empty_folder() as folder:
        assert [*temporary.iterdir()] == [folder.parent]
        assert not [*folder.iterdir()]
    assert not [*temporary.iterdir()]


def test_a_folder_that_cannot_be_made(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Say which, why, and what to do: TMPDIR is full, or was removed after the first of many runs."""
    monkeypatch.setattr(tempfile, "tempdir", str(temporary / "gone"))
    wanted = f"cannot make the temporary file {temporary}/gone/gsb-new-.*: No such file or directory; set TMPDIR to a"
    with pytest.raises(GsbError, match=wanted), scratch.scratch_folder():
        pass


def test_a_folder_that_is_removed_during_a_run(plugin: dict[str, str], tmp_path: Path, temporary: Path) -> None:
    """End the recording as ever, and say in its log that the log is gone: systems remove old temporary files."""
    run = [*command("gsb-record"), "--sim", "faulty", "--option", "mode=held", "--phases", "capture", "--n-env", "4"]
    recorder = subprocess.Popen(
        [*run, "--steps", "20", "--runs", "1", "--out", str(tmp_path)], stdout=subprocess.PIPE, text=True,
        env={**plugin, "TMPDIR": str(temporary)},
    )  # fmt: skip
    wait_for(lambda: any(path.stat().st_size for path in tmp_path.glob("*.partial")))
    (folder,) = temporary.glob("gsb-work-*")
    shutil.rmtree(folder)
    (folder_of(plugin) / "let-go").touch()
    path = recorder.communicate()[0].strip()
    assert open_recording(path).status == "complete"
    assert Container(path).attachment(ENGINE_LOG) == b"--- what was printed cannot be read: No such file or directory\n"


_NODE = "from gpusimbench.recorder.cluster.node import main; main()"
_CONFORMANCE = "from gpusimbench.recorder.conformance import Subject; Subject.named('mujoco').recording"
_SOFTWARE = """
import sys
from pathlib import Path
from gpusimbench.recorder.environments.interpreter import Interpreter
Interpreter(Path(sys.argv[1])).software()
"""


@pytest.mark.parametrize("program", [_NODE, _CONFORMANCE, _SOFTWARE], ids=["node", "conformance", "other Python"])
def test_other_makers_of_folders_are_killed(tmp_path: Path, temporary: Path, program: str) -> None:
    """Remove what was left on a machine of a cluster, by a run of conformance, and by a look at another Python."""
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexec sleep 600\n")
    python.chmod(0o755)
    arguments = [sys.executable, "-c", program, str(python)]
    process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True)
    process.stdin.write(b'{"code": ""}\n')
    process.stdin.flush()
    wait_for(lambda: any(temporary.glob("gsb-[!n]*")))  # not those without a lock yet
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()

    def removed() -> bool:
        scratch.remove_abandoned()
        return not any(temporary.iterdir())

    wait_for(removed)  # a run that was begun removes its own folder
