"""Runs that go wrong: the file says so, other runs are unharmed, the message is clear, the exit code is right."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from gpusimbench import open_recording
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.schemas.errors import DamagedRecording, DataLost, RecordingError
from tests.conftest import Command, command, run_python, wait_for
from tests.limits import full_disk
from tests.reading import verified


def _run(
    gsb_record: Command, plugin: dict[str, str], out: Path, mode: str, *more: object, code: int | None = None
) -> Any:
    return gsb_record(
        "--sim", "faulty", "--n-env", 2, "--runs", 2, "--steps", 20, "--warmup", 0, "--timed-steps", 3,
        "--option", f"mode={mode}", *more, "--out", out, env=plugin, code=code,
    )  # fmt: skip


def test_a_third_party_simulator_records(gsb_record: Command, plugin: dict[str, str], tmp_path: Path) -> None:
    """Find a simulator that another distribution offers, and keep what it prints."""
    done = _run(gsb_record, plugin, tmp_path, "good", code=0)
    recording = verified(sorted(tmp_path.glob("*.mcap"))[0])
    assert recording.state("cubes", "position")[20, 0, 0, 0] == 20.0
    assert b"printed while building" in (recording.attachment("engine-log.txt") or b"")
    assert "printed" not in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("mode", "status", "reason"),
    [
        pytest.param("build", "failed", "RuntimeError in phase init: no device of that name", marks=pytest.mark.slow),
        ("raise", "failed", "ValueError in phase capture: the solver gave up"),
        pytest.param("memory", "failed", "out of host memory in phase capture", marks=pytest.mark.slow),
        ("nan", "invalid", "a state is not finite: step 5, env 0, cubes/position of b"),
        ("gate", "invalid", "phase warmup: contacts were dropped; the same in phase timed"),
        ("queue", "invalid", "step() returns before the device is done, so the clocks do not cover the work"),
    ],
)
def test_a_run_that_fails_says_why(
    gsb_record: Command, plugin: dict[str, str], tmp_path: Path, mode: str, status: str, reason: str
) -> None:
    """Write the reason into a whole recording, report it in one line, go on with the next run, end with 1."""
    done = _run(gsb_record, plugin, tmp_path, mode, code=1)
    assert "Traceback" not in done.stderr
    assert done.stderr.count(reason) == 2
    files = sorted(tmp_path.iterdir())
    assert [f.suffix for f in files] == [".mcap", ".mcap"]
    for file in files:
        recording = verified(file)
        assert recording.status == status
        assert reason in recording.reason


@pytest.mark.parametrize(
    ("mode", "how"),
    [
        ("segfault", "was killed by SIGSEGV"),
        pytest.param("exit", "ended with exit code 7", marks=pytest.mark.slow),
    ],
)
def test_a_run_that_dies_is_incomplete(
    gsb_record: Command, plugin: dict[str, str], tmp_path: Path, mode: str, how: str
) -> None:
    """Keep what was written under its .partial name, say how the process ended, end with 3."""
    done = _run(gsb_record, plugin, tmp_path, mode, code=3)
    assert done.stderr.count(how) == 2
    files = sorted(tmp_path.iterdir())
    assert [f.suffix for f in files] == [".partial", ".partial"]
    for file in files:
        recording = open_recording(file)
        assert recording.status == "incomplete"
        assert recording.configuration.simulator == "faulty"


def test_an_interruption_ends_the_recording(plugin: dict[str, str], tmp_path: Path) -> None:
    """End the present run's recording with the reason on Ctrl-C, start no other, keep those before."""
    process = subprocess.Popen(
        [*command("gsb-record"), "--sim", "faulty", "--n-env", "2", "--runs", "3", "--steps", "2000", "--phases",
         "capture", "--option", "mode=slow", "--out", str(tmp_path)],
        env=plugin, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    wait_for(lambda: any(b"gsb.v1.StateBlock" in p.read_bytes() for p in tmp_path.glob("*.partial")))
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "interrupted: 1 of 3 runs were started" in err
    (file,) = tmp_path.iterdir()
    assert str(file) == out.strip()
    recording = verified(file)
    assert (recording.status, recording.reason) == ("failed", "interrupted in phase capture")


def test_a_run_ends_with_the_command_that_started_it(plugin: dict[str, str], tmp_path: Path) -> None:
    """End the recording when the command is killed outright, instead of computing for nobody."""
    process = subprocess.Popen(
        [*command("gsb-record"), "--sim", "faulty", "--runs", "1", "--steps", "100000", "--phases", "capture",
         "--option", "mode=slow", "--out", str(tmp_path)],
        env=plugin, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    wait_for(lambda: any(b"gsb.v1.StateBlock" in p.read_bytes() for p in tmp_path.glob("*.partial")))
    process.kill()
    process.wait()
    wait_for(lambda: [path.suffix for path in tmp_path.iterdir()] == [".mcap"])  # it has both names for a moment
    (file,) = tmp_path.iterdir()
    assert open_recording(file).status == "failed"


@pytest.mark.parametrize(
    "limit", [60_000, *(pytest.param(n, marks=pytest.mark.slow) for n in (2_000, 400_000, 1_500_000))]
)
def test_a_full_disk(gsb_record: Command, tmp_path: Path, limit: int) -> None:
    """Say that writing stopped, end with 3, and leave no file that reads as complete."""

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = gsb_record("--sim", "mujoco", "--n-env", 4, "--runs", 2, "--steps", 200, "--warmup", 0, "--timed-steps", 5,
                      "--out", tmp_path, preexec_fn=small_disk, code=3)  # fmt: skip
    assert "Traceback" not in done.stderr
    assert done.stderr.count("writing stopped: File too large") == 2
    files = sorted(tmp_path.iterdir())
    assert [f.suffix for f in files] == [".partial"] * 2
    for file in files:
        assert _status(file) in ("incomplete", "unreadable")


def _status(file: Path) -> str:
    try:
        return open_recording(file).status
    except RecordingError as error:
        assert isinstance(error, DamagedRecording) or file.stat().st_size < 100
        return "unreadable"


def test_gates_are_asked_after_every_phase(gsb_record: Command, plugin: dict[str, str], tmp_path: Path) -> None:
    """Call a run invalid whose gates fire in the timed phase, though nothing is captured."""
    _run(gsb_record, plugin, tmp_path, "gate", "--phases", "timed", code=1)
    for file in tmp_path.iterdir():
        recording = verified(file)
        reason = "phase warmup: contacts were dropped; the same in phase timed"
        assert (recording.status, recording.reason) == ("invalid", reason)
        fired = [(e.phase, e.text) for e in recording.events if e.kind == "GATE"]
        assert fired == [("warmup", "contacts were dropped"), ("timed", "contacts were dropped")]


@pytest.mark.parametrize(
    ("mode", "made", "reason"),
    [
        ("good", 2, ""),
        ("build", 1, "no device"),
        ("second", 1, "no second one"),
        ("second-build", 2, "no second build"),
        ("raise", 2, "the solver gave up"),
    ],
)
def test_a_simulator_is_closed_once(
    gsb_record: Command, plugin: dict[str, str], tmp_path: Path, mode: str, made: int, reason: str
) -> None:
    """Close each simulator that was made exactly once, also when it or the next one cannot be built."""
    _run(gsb_record, plugin, tmp_path, mode, "--runs", 1)
    (file,) = tmp_path.iterdir()
    recording = verified(file)
    assert reason in recording.reason
    said = (recording.attachment("engine-log.txt") or b"").decode().split()
    assert [word for word in said if word.startswith("closed")] == [f"closed{number}" for number in range(made)]


def test_a_process_that_cannot_start_says_why(gsb_record: Command, tmp_path: Path) -> None:
    """Report in one line what kept the run's process from recording, end with 1, leave no file."""
    (tmp_path / "path").mkdir()
    (tmp_path / "path" / "psutil.py").write_text("raise RuntimeError('this psutil is broken')\n")
    done = gsb_record(
        "--sim", "mujoco", "--runs", 1, "--out", tmp_path / "out",
        env={**os.environ, "PYTHONPATH": str(tmp_path / "path")}, code=1,
    )  # fmt: skip
    assert "RuntimeError: this psutil is broken" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list((tmp_path / "out").iterdir())


def test_the_last_words_of_a_process(gsb_record: Command, plugin: dict[str, str], tmp_path: Path) -> None:
    """Say what a process printed last that died without a report."""
    done = _run(gsb_record, plugin, tmp_path, "exit", "--runs", 1, code=3)
    assert done.stderr.strip().endswith("the last that it printed: printed while building")


@pytest.mark.slow
def test_nothing_is_left_of_a_run_that_died(gsb_record: Command, plugin: dict[str, str], tmp_path: Path) -> None:
    """Remove the scratch folder also of a process that was killed."""
    (tmp_path / "tmp").mkdir()
    for mode in ("good", "segfault"):
        _run(gsb_record, {**plugin, "TMPDIR": str(tmp_path / "tmp")}, tmp_path / mode, mode)
    assert not list((tmp_path / "tmp").iterdir())


def _written(folder: Path) -> Sink:
    sink = Sink(folder / "x.mcap", compression="none")
    sink.channel("/run/event", "gsb.v1.Event")
    sink.write("/run/event", b"")
    return sink


def test_a_folder_that_is_deleted(tmp_path: Path) -> None:
    """Send nobody to a file that is there no more."""
    (tmp_path / "out").mkdir()
    sink = _written(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    with pytest.raises(DataLost, match=r"writing stopped: No such file.*x\.mcap\.partial is there no more"):
        sink.finish("COMPLETE", "", last_step=0, peak_rss_bytes=0)


def test_a_disk_that_takes_nothing(tmp_path: Path) -> None:
    """Send nobody to a file without a byte, which gsb-record removes."""
    with full_disk(0):
        sink = Sink(tmp_path / "x.mcap", compression="none")
        with pytest.raises(DataLost, match="^writing stopped: File too large; nothing was written$"):
            sink.channel("/run/event", "gsb.v1.Event")
        sink.abandon()


def test_a_file_system_without_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rename where hard links are not there, but never over a file, and not after any other error."""

    def refuse(number: int) -> None:
        def link(*_: object) -> None:
            raise OSError(number, os.strerror(number))

        monkeypatch.setattr(os, "link", link)

    refuse(errno.EPERM)
    assert _written(tmp_path).finish("COMPLETE", "", last_step=0, peak_rss_bytes=0).exists()
    (tmp_path / "x.mcap").unlink()
    sink = _written(tmp_path)
    (tmp_path / "x.mcap").write_text("somebody's")
    with pytest.raises(DataLost, match="appeared meanwhile"):
        sink.finish("COMPLETE", "", last_step=0, peak_rss_bytes=0)
    assert (tmp_path / "x.mcap").read_text() == "somebody's"
    (tmp_path / "x.mcap").unlink()
    sink.partial.unlink()
    refuse(errno.EIO)
    with pytest.raises(DataLost, match="Input/output error"):
        _written(tmp_path).finish("COMPLETE", "", last_step=0, peak_rss_bytes=0)
    assert not (tmp_path / "x.mcap").exists()


def test_a_missing_package_is_named() -> None:
    """Say which package a simulator needs and how to get it."""
    from gpusimbench.recorder.simulators.registry import Entry
    from gpusimbench.schemas.errors import UsageError

    entry = Entry(
        "warped", "", "recorder.nowhere:Nothing", requires=("surely_not_installed",), install="pip install it"
    )
    with pytest.raises(UsageError, match="'warped' needs surely_not_installed, which is not installed: pip install it"):
        entry.load()


def test_without_mujoco_the_command_says_how_to_get_it(tmp_path: Path) -> None:
    """Refuse with the install command where MuJoCo is not there."""
    # an interpreter that sees this project and its base dependencies, but no mujoco
    code = (
        "import sys, importlib.util as u; f = u.find_spec; "
        "u.find_spec = lambda n, *a: None if n == 'mujoco' else f(n, *a); "
        "from gpusimbench.recorder.cli import main; sys.exit(main(['--sim', 'mujoco']))"
    )
    done = run_python(code, code=2, cwd=tmp_path)
    assert "pip install 'gpusimbench[mujoco]'" in done.stderr
