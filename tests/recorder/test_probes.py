"""Probes that fail: the run goes on, and its recording says what is missing."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from evaluator import open_recording
from recorder.environment import apply_environment
from recorder.probes.software import package_list
from schemas.errors import UsageError
from tests.conftest import SMALL, Command

_NVML = '''
"""NVML of a machine with two GPUs that fail as they are told."""
import os

class NVMLError(Exception):
    pass

NVML_CLOCK_SM, NVML_CLOCK_MEM = 1, 2
_how = os.environ["NVML_FAILS"]
_readings = 0

class _Memory:
    used, total = 5, 10

def nvmlInit(): pass
def nvmlShutdown(): raise NVMLError("never initialised")

def nvmlDeviceGetCount():
    if _how == "count":
        raise NVMLError("Driver/library version mismatch")
    return 2

def nvmlDeviceGetHandleByIndex(index):
    if _how == "handle" and index == 1:
        raise NVMLError("GPU is lost")
    return index

def nvmlDeviceGetName(handle): return b"Test \\xff"
def nvmlDeviceGetComputeRunningProcesses(handle): raise NVMLError("Not Supported")

def nvmlDeviceGetMemoryInfo(handle):
    global _readings
    _readings += 1
    if _how == "memory" and handle == 1 and _readings > 8:
        raise NVMLError("GPU is lost")
    return _Memory()
'''


@pytest.mark.parametrize(
    ("how", "gpus", "note"),
    [
        ("nothing", 2, None),
        ("count", 0, "NVML does not say how many GPUs there are: Driver/library version mismatch"),
        ("handle", 1, "GPU 1 is left out, it does not answer: GPU is lost"),
        ("memory", 2, "memory readings failed, the last one: gpu1: NVMLError: GPU is lost"),
    ],
)
def test_a_driver_that_fails(gsb_record: Command, tmp_path: Path, how: str, gpus: int, note: str | None) -> None:
    """Complete the run, sample on what is left, and note what failed."""
    (tmp_path / "pynvml.py").write_text(_NVML)
    done = gsb_record(
        "--sim", "mujoco", "--n-env", 1, "--runs", 1, *SMALL, "--out", tmp_path / "out",
        env={**os.environ, "PYTHONPATH": str(tmp_path), "NVML_FAILS": how},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    recording = open_recording(done.stdout.strip())
    recording.verify()
    assert len(recording.provenance.gpus) == gpus
    notes = [e.text for e in recording.events if e.kind == "NOTE"]
    assert len(notes) == (note is not None)
    assert note is None or note in notes[0]
    host = recording.memory["host"]
    assert [c for c in host.checkpoint if c] == ["baseline", "post-init", "post-warmup", "final"]
    if how == "memory":
        number = int(notes[0].split()[0])
        lost = len(recording.memory["gpu0/device"].time_ns) - len(recording.memory["gpu1/device"].time_ns)
        assert 0 < lost <= number


@pytest.mark.parametrize(
    ("given", "wanted", "found"),
    [
        (None, "--a=1 --b=2", "--a=1 --b=2"),
        ("--c=3", "--a=1", "--c=3 --a=1"),
        ("--a=1", "--a=1 --b=2", "--a=1 --b=2"),
    ],
)
def test_flags_are_added(given: str | None, wanted: str, found: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Add an engine's flags to the user's, each once."""
    monkeypatch.setenv("XLA_FLAGS", given or "")  # noted, so that what the test sets is taken back
    if given is None:
        monkeypatch.delenv("XLA_FLAGS")
    apply_environment({"XLA_FLAGS": wanted})
    assert os.environ["XLA_FLAGS"] == found


def test_a_flag_that_contradicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse a level whose flag the user has set to something else: it would be recorded and not in force."""
    monkeypatch.setenv("XLA_FLAGS", "--level=4")
    with pytest.raises(UsageError, match="--level=4.*--level=0"):
        apply_environment({"XLA_FLAGS": "--level=0"})


def test_other_variables_stay_as_the_user_set_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Set what is not set, and nothing else."""
    monkeypatch.setenv("GSB_TEST_ONE", "user")
    monkeypatch.delenv("GSB_TEST_TWO", raising=False)
    apply_environment({"GSB_TEST_ONE": "engine", "GSB_TEST_TWO": "engine"})
    assert (os.environ["GSB_TEST_ONE"], os.environ.pop("GSB_TEST_TWO")) == ("user", "engine")


def test_a_package_of_two_versions(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """List the version that Python imports, where a folder later on the path has another."""
    for place, version in (("near", "2.0"), ("far", "1.0")):
        info = tmp_path / place / f"gsb_twice-{version}.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: gsb-twice\nVersion: {version}\n")
    monkeypatch.setattr("sys.path", [str(tmp_path / "near"), str(tmp_path / "far"), *sys.path])
    assert [line for line in package_list().splitlines() if line.startswith("gsb-twice")] == ["gsb-twice==2.0"]
