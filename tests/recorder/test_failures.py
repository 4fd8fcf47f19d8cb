"""Runs that go wrong: the file says so, other runs are unharmed, the message is clear, the exit code is right."""

from __future__ import annotations

import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from evaluator import open_recording
from schemas.errors import DamagedRecording, RecordingError
from tests.conftest import SMALL, Command, command

_PLUGIN = '''
"""A third party's simulator that goes wrong as it is told."""
import os, signal, time
from dataclasses import dataclass
import numpy as np
from recorder.simulators.base import Description, Simulator
from schemas.fields import body_field

@dataclass(frozen=True)
class Options:
    mode: str = "good"
    at: int = 5

class Faulty(Simulator):
    Options = Options

    def build(self):
        print("printed while building")
        if self.options.mode == "build":
            raise RuntimeError("no device\\nof that name")
        self.k = 0
        field = body_field("cubes", "position", "float32", ("a", "b"))
        return Description("1.0", "cpu", {}, {}, (), (field,), timing_covers="nothing")

    def step(self, n_step):
        for _ in range(n_step):
            self.k += 1
            if self.k >= self.options.at:
                if self.options.mode == "raise":
                    raise ValueError("the solver gave up")
                if self.options.mode == "memory":
                    raise MemoryError
                if self.options.mode == "segfault":
                    os.kill(os.getpid(), signal.SIGSEGV)
                if self.options.mode == "exit":
                    os._exit(7)
                if self.options.mode == "slow":
                    time.sleep(0.01)

    def state(self):
        state = np.full((self.n_env, 2, 3), float(self.k), dtype=np.float32)
        if self.options.mode == "nan" and self.k >= self.options.at:
            state[0, 1, 2] = np.nan
        return (state,)

    def gates(self):
        return ["contacts were dropped"] if self.options.mode == "gate" else []
'''


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which a third party's distribution offers the simulator "faulty"."""
    folder = tmp_path_factory.mktemp("plugin")
    (folder / "faulty_simulator.py").write_text(_PLUGIN)
    info = folder / "faulty_simulator-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: faulty-simulator\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[gsb.simulators]\nfaulty = faulty_simulator:Faulty\n")
    return {**os.environ, "PYTHONPATH": str(folder)}


def _run(gsb_record: Command, plugin: dict[str, str], out: Path, mode: str, *more: object):  # type: ignore[no-untyped-def]
    return gsb_record(
        "--sim", "faulty", "--n-env", 2, "--runs", 2, "--steps", 20, "--warmup", 0, "--timed-steps", 3,
        "--option", f"mode={mode}", *more, "--out", out, env=plugin,
    )  # fmt: skip


def test_a_third_party_simulator_records(gsb_record: Command, plugin: dict[str, str], tmp_path: Path) -> None:
    """Find a simulator that another distribution offers, and keep what it prints."""
    done = _run(gsb_record, plugin, tmp_path, "good")
    assert done.returncode == 0, done.stderr
    recording = open_recording(sorted(tmp_path.glob("*.mcap"))[0])
    recording.verify()
    assert recording.state("cubes", "position")[20, 0, 0, 0] == 20.0
    assert b"printed while building" in (recording.attachment("engine-log.txt") or b"")
    assert "printed" not in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("mode", "status", "reason"),
    [
        ("build", "failed", "RuntimeError in phase init: no device of that name"),
        ("raise", "failed", "ValueError in phase capture: the solver gave up"),
        ("memory", "failed", "out of host memory in phase capture"),
        ("nan", "invalid", "a state is not finite: step 5, env 0, cubes/position of b"),
        ("gate", "invalid", "contacts were dropped"),
    ],
)
def test_a_run_that_fails_says_why(
    gsb_record: Command, plugin: dict[str, str], tmp_path: Path, mode: str, status: str, reason: str
) -> None:
    """Write the reason into a whole recording, report it in one line, go on with the next run, end with 1."""
    done = _run(gsb_record, plugin, tmp_path, mode)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert done.stderr.count(reason) == 2
    files = sorted(tmp_path.iterdir())
    assert [f.suffix for f in files] == [".mcap", ".mcap"]
    for file in files:
        recording = open_recording(file)
        recording.verify()
        assert (recording.status, recording.reason) == (status, reason)


@pytest.mark.parametrize(("mode", "how"), [("segfault", "was killed by SIGSEGV"), ("exit", "ended with exit code 7")])
def test_a_run_that_dies_is_incomplete(
    gsb_record: Command, plugin: dict[str, str], tmp_path: Path, mode: str, how: str
) -> None:
    """Keep what was written under its .partial name, say how the process ended, end with 3."""
    done = _run(gsb_record, plugin, tmp_path, mode)
    assert done.returncode == 3
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
    _wait_for(lambda: any(b"gsb.v1.StateBlock" in p.read_bytes() for p in tmp_path.glob("*.partial")))
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "interrupted: 1 of 3 runs were started" in err
    (file,) = tmp_path.iterdir()
    assert str(file) == out.strip()
    recording = open_recording(file)
    recording.verify()
    assert (recording.status, recording.reason) == ("failed", "interrupted in phase capture")


def test_a_run_ends_with_the_command_that_started_it(plugin: dict[str, str], tmp_path: Path) -> None:
    """End the recording when the command is killed outright, instead of computing for nobody."""
    process = subprocess.Popen(
        [*command("gsb-record"), "--sim", "faulty", "--runs", "1", "--steps", "100000", "--phases", "capture",
         "--option", "mode=slow", "--out", str(tmp_path)],
        env=plugin, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    _wait_for(lambda: any(b"gsb.v1.StateBlock" in p.read_bytes() for p in tmp_path.glob("*.partial")))
    process.kill()
    process.wait()
    _wait_for(lambda: bool(list(tmp_path.glob("*.mcap"))))
    (file,) = tmp_path.iterdir()
    assert open_recording(file).status == "failed"


@pytest.mark.parametrize("limit", [2_000, 60_000, 400_000, 1_500_000])
def test_a_full_disk(gsb_record: Command, tmp_path: Path, limit: int) -> None:
    """Say that writing stopped, end with 3, and leave no file that reads as complete."""

    def small_disk() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    done = gsb_record("--sim", "mujoco", "--n-env", 4, "--runs", 2, "--steps", 200, "--warmup", 0, "--timed-steps", 5,
                      "--out", tmp_path, preexec_fn=small_disk)  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.count("writing stopped: File too large") == 2
    files = sorted(tmp_path.iterdir())
    assert [f.suffix for f in files] == [".partial"] * 2
    for file in files:
        assert _status(file) in ("incomplete", "unreadable")


def test_killed_at_any_moment(tmp_path: Path) -> None:
    """Leave, after SIGKILL at 24 moments over a whole run, either a complete file or one that says it is not."""
    arguments = [*command("gsb-record"), "--sim", "mujoco", "--n-env", "4", "--runs", "1", *SMALL]
    began = time.monotonic()
    subprocess.run([*arguments, "--out", str(tmp_path / "whole")], check=True, capture_output=True)
    whole = time.monotonic() - began
    seen = set()
    moments = random.Random(0)
    for number in range(24):
        out = tmp_path / str(number)
        process = subprocess.Popen(
            [*arguments, "--out", str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        time.sleep(whole * (0.25 + 0.8 * (number + moments.random()) / 24))
        for child in _children(process.pid):
            os.kill(child, signal.SIGKILL)
        process.wait(timeout=60)
        for file in out.iterdir() if out.exists() else ():
            status = _status(file)
            seen.add(status)
            assert (status == "complete") == (file.suffix == ".mcap"), file
            if status == "incomplete":
                _check_states(file)
    assert "incomplete" in seen


def _check_states(file: Path) -> None:
    # what was reported as written is there, and right: rows from the start on, without gaps
    recording = open_recording(file)
    recording.verify()
    if recording.simulation is None:
        return
    array = recording.state("cubes", "position")
    if len(array):
        assert array[:].shape[1:] == (4, 27, 3)
        hashes = recording.fingerprints("capture")
        assert hashes is not None
        assert len(hashes.steps) >= len(array)


def _status(file: Path) -> str:
    try:
        return open_recording(file).status
    except RecordingError as error:
        assert isinstance(error, DamagedRecording) or file.stat().st_size < 100
        return "unreadable"


def _children(pid: int) -> list[int]:
    try:
        return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except FileNotFoundError:
        return []


def _wait_for(condition) -> None:  # type: ignore[no-untyped-def]
    for _ in range(600):
        if condition():
            return
        time.sleep(0.1)
    raise AssertionError("it did not happen within a minute")


def test_a_missing_package_is_named() -> None:
    """Say which package a simulator needs and how to get it."""
    from recorder.simulators.registry import Entry
    from schemas.errors import UsageError

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
        "from recorder.cli import main; sys.exit(main(['--sim', 'mujoco']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert "pip install 'gpusimbench[mujoco]'" in done.stderr
