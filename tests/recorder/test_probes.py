"""Probes that fail: the run goes on, and its recording says what is missing."""

from __future__ import annotations

import os
import sys
from importlib import metadata
from itertools import groupby
from pathlib import Path
from subprocess import PIPE, Popen
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench import open_recording
from gpusimbench.recorder.capture.samples import Sampling
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.probes.gpu import Gpus, Processes
from gpusimbench.recorder.probes.host import describe_software, package_list
from gpusimbench.recorder.probes.sampling import MemorySampler
from gpusimbench.recorder.run.engine import apply_environment
from gpusimbench.schemas import topics
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.provenance import PROVENANCE, Provenance
from tests.conftest import SMALL, Command
from tests.reading import verified

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
        pytest.param(
            "count", 0, "NVML does not say how many GPUs there are: Driver/library version mismatch",
            marks=pytest.mark.slow,
        ),
        pytest.param("handle", 1, "GPU 1 is left out, it does not answer: GPU is lost", marks=pytest.mark.slow),
        ("memory", 2, "memory readings failed, the last one: gpu1: NVMLError: GPU is lost"),
    ],
)  # fmt: skip
def test_a_driver_that_fails(gsb_record: Command, tmp_path: Path, how: str, gpus: int, note: str | None) -> None:
    """Complete the run, sample on what is left, and note what failed."""
    (tmp_path / "pynvml.py").write_text(_NVML)
    done = gsb_record(
        "--sim", "mujoco", "--n-env", 1, "--runs", 1, *SMALL, "--out", tmp_path / "out",
        env={**os.environ, "PYTHONPATH": str(tmp_path), "NVML_FAILS": how}, code=0,
    )  # fmt: skip
    recording = verified(done.stdout.strip())
    assert len(recording.provenance.gpus) == gpus
    notes = [e.text for e in recording.events if e.kind == "NOTE"]
    assert len(notes) == (note is not None)
    assert note is None or note in notes[0]
    host = recording.memory["host"]
    assert [c for c in host.checkpoint if c] == ["baseline", "post-init", "post-warmup", "final"]
    if how == "memory":
        number = int(notes[0].split()[0])
        lost = recording.memory["gpu0/device"].readings - recording.memory["gpu1/device"].readings
        assert 0 < lost <= number


@given(st.lists(st.tuples(st.integers(1, 3), st.sampled_from(["", "", "", "final", "take"])), min_size=1, max_size=40))
def test_equal_readings_in_a_row(read: list[tuple[int, str]]) -> None:
    """Keep the first and the last, and how many were between them, so that every reading can be had again."""
    with Gpus(hidden=True) as gpus:
        sampler = MemorySampler(gpus)
    values = iter([used for used, _ in read])
    sampler._process = SimpleNamespace(memory_info=lambda: SimpleNamespace(rss=next(values)))
    kept = list[dict[str, Any]]()
    for _, what in read:
        sampler.checkpoint(what) if what == "final" else sampler.read_now()
        kept += [reading.fields for reading in sampler.take()] if what == "take" else []
    kept += [reading.fields for reading in sampler.take() if reading.topic == topics.MEMORY_HOST]
    every = list[int]()
    for fields in kept:
        assert not fields.get("omitted_readings") or every[-1] == fields["used_bytes"]
        every += [fields["used_bytes"]] * (1 + fields.get("omitted_readings", 0))
    assert every == [used for used, _ in read]
    assert [f["checkpoint"] for f in kept if f["checkpoint"]] == [what for _, what in read if what == "final"]
    if not any(what for _, what in read):
        assert len(kept) == sum(min(len(list(alike)), 2) for _, alike in groupby(every))


class _Process(NamedTuple):
    pid: int
    usedGpuMemory: int | None  # noqa: N815 (NVML's word)


_OWN, _OTHER, _UNTOLD = _Process(os.getpid(), 500), _Process(1, 70), _Process(1, None)


class _Nvml(ModuleType):
    """NVML of one GPU; what it lists is a list of processes, or the number of the error that it raises."""

    nvmlMemory_v2 = 2  # noqa: N815 (NVML's word)

    class NVMLError(Exception):
        """As the bindings have it."""

        def __init__(self, value: int) -> None:
            super().__init__(f"error {value}")
            self.value = value

    def __init__(self, compute: list[_Process] | int, graphics: list[_Process] | int = 3) -> None:
        super().__init__("pynvml")
        self.compute, self.graphics = compute, graphics
        self.nvmlInit = self.nvmlShutdown = lambda: None
        self.nvmlDeviceGetCount = lambda: 1
        self.nvmlDeviceGetHandleByIndex = lambda index: index
        self.nvmlDeviceGetComputeRunningProcesses = lambda handle: self._told(self.compute)
        self.nvmlDeviceGetGraphicsRunningProcesses = lambda handle: self._told(self.graphics)

    def _told(self, listed: list[_Process] | int) -> list[_Process]:
        if isinstance(listed, int):
            raise self.NVMLError(listed)
        return listed

    def nvmlDeviceGetMemoryInfo(self, handle: int, version: int | None = None) -> Any:  # noqa: N802
        """Version 2 alone tells what is reserved."""
        return SimpleNamespace(used=5, total=10, **({"reserved": 4} if version == self.nvmlMemory_v2 else {}))


@pytest.mark.parametrize(
    ("nvml", "before_engine", "own", "others", "other_bytes"),
    [
        (_Nvml([_OWN]), False, 500, 0, 0),
        (_Nvml([_OWN, _OTHER]), False, 500, 1, 70),
        (_Nvml([_OWN, _UNTOLD]), False, 500, 1, None),
        (_Nvml([_OWN, _OTHER], [_Process(2, 30), _OTHER]), False, 500, 2, 100),
        (_Nvml([]), True, None, 0, 0),
        (_Nvml([_OTHER]), True, None, 1, 70),
        # the container's driver does not list this process, or by a number that is not its own here
        (_Nvml([]), False, None, None, None),
        (_Nvml([_OTHER]), False, None, None, None),
        # it lists processes without bytes
        (_Nvml([_OWN._replace(usedGpuMemory=None)]), False, None, 0, 0),
        (_Nvml(999), True, None, None, None),
        (_Nvml([_OWN], 999), False, 500, None, None),
    ],
)
def test_other_processes_on_a_gpu(
    nvml: _Nvml,
    before_engine: bool,
    own: int | None,
    others: int | None,
    other_bytes: int | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Tell the others from this process where NVML lists this process, and otherwise say nothing, least of all zero."""
    monkeypatch.setitem(sys.modules, "pynvml", nvml)
    with Gpus(hidden=True) as gpus:
        found = gpus.processes(0, before_engine=before_engine)
        assert (found.own_bytes, found.others, found.other_bytes) == (own, others, other_bytes)
        assert gpus.device_memory(0) == (5, 10)
        assert gpus.reserved_memory(0) == 4


def test_what_the_engine_starts_is_no_co_tenant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Count no process that the recording one started."""
    with Popen([sys.executable, "-c", "input()"], stdin=PIPE) as child:
        monkeypatch.setitem(sys.modules, "pynvml", _Nvml([_OWN, _Process(child.pid, 30), _OTHER]))
        with Gpus(hidden=True) as gpus:
            assert gpus.processes(0, before_engine=False) == Processes(500, 1, 70)
        child.communicate(b"\n")


def test_co_tenants_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write who else was there with every reading of the device, and what the driver keeps at checkpoints."""
    nvml = _Nvml([_OTHER])
    monkeypatch.setitem(sys.modules, "pynvml", nvml)
    with Gpus(hidden=True) as gpus:
        sink = Sink(tmp_path / "run.mcap", compression="none")
        writer = Sampling(sink, gpus)
        writer.enter("baseline")
        writer.checkpoint("baseline")
        writer.enter("timed")
        nvml.compute = [_OWN, _OTHER, _Process(2, 30)]
        writer.leave()
        writer.enter("timed")
        nvml.compute = []
        writer.checkpoint("final")
        writer.drain()
    asked = RunConfiguration("s", "free-fall", 1, 0.01, 1)
    sink.attach(PROVENANCE, "application/json", Provenance("id", "", (), asked).to_json().encode())
    path = sink.finish("COMPLETE", "", last_step=0, peak_rss_bytes=0)
    trace = open_recording(path).memory["gpu0/device"]
    assert trace.others == ((1, 70), (2, 100), (None, None))
    assert trace.reserved == {"baseline": 4, "final": 4}
    assert trace.most_others(checkpoint="baseline") == (1, 70)
    assert trace.most_others(phase="timed") == (2, 100)
    assert trace.most_others(checkpoint="final") is None


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


def test_packages_are_named_as_python_names_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """List what a parse of all metadata says, of packages here and of metadata that lead a quick look astray."""
    for name, file, text in (
        ("spelled.dist-info", "METADATA", "metadata-version: 2.1\nNAME: Spelled.Out\nversion:   1.0\n"),
        ("described.dist-info", "METADATA", "Name: described\nVersion: 2.0\n\nVersion: 3.0\n"),
        ("folded.dist-info", "METADATA", "Name: folded\nLicense: of\n        Version: 4.0\nVersion: 5.0\n"),
        ("split.dist-info", "METADATA", "Name: split\nSummary: a\u2028Version: 4.5\nVersion: 5.5\n"),
        ("nameless.dist-info", "METADATA", "Version: 6.0\n"),
        ("unversioned.dist-info", "METADATA", "Name: unversioned\n"),
        ("old.egg-info", "PKG-INFO", "Name: old\nVersion: 7.0\n"),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_text(text, encoding="utf-8")
    (tmp_path / "oldest.egg-info").write_text("Name: oldest\nVersion: 8.0\n")
    monkeypatch.setattr("sys.path", [str(tmp_path), *sys.path])
    parsed: dict[str, str] = {}
    for found in metadata.distributions():
        parsed.setdefault(found.metadata["Name"] or "?", found.version)
    assert {"Spelled.Out", "described", "folded", "?", "old", "oldest", "numpy"} <= parsed.keys()
    assert dict(line.split("==") for line in package_list().splitlines()) == {n: str(v) for n, v in parsed.items()}


def test_metadata_in_another_encoding(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Record beside a package whose metadata are not UTF-8, and list that there is one."""
    (tmp_path / "foreign-1.0.dist-info").mkdir()
    (tmp_path / "foreign-1.0.dist-info" / "METADATA").write_bytes(b"Name: foreign\nVersion: 1.0\nAuthor: Ren\xe9\n")
    monkeypatch.setattr("sys.path", [str(tmp_path), *sys.path])
    assert "?==None" in package_list().splitlines()
    monkeypatch.setattr("gpusimbench.recorder.probes.host.NUMERIC_PACKAGES", ("foreign", "numpy"))
    assert list(describe_software()["packages"]) == ["numpy"]


def test_a_package_of_two_versions(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """List the version that Python imports, where a folder later on the path has another."""
    for place, version in (("near", "2.0"), ("far", "1.0")):
        info = tmp_path / place / f"gsb_twice-{version}.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: gsb-twice\nVersion: {version}\n")
    monkeypatch.setattr("sys.path", [str(tmp_path / "near"), str(tmp_path / "far"), *sys.path])
    assert [line for line in package_list().splitlines() if line.startswith("gsb-twice")] == ["gsb-twice==2.0"]
