"""Clock rates, power, temperature and load: what a machine tells of them is recorded, and what it does not tell too."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple

import pytest

from gpusimbench import open_recording
from gpusimbench.evaluator.check.hardware import hardware_of
from gpusimbench.evaluator.check.integrity import examine
from gpusimbench.evaluator.check.integrity.problem import Kind
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.recorder.capture.samples import SampleWriter
from gpusimbench.recorder.capture.sink import Sink
from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.sampling import Cpus, HardwareSampler
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.messages import message_class
from gpusimbench.schemas.provenance import PROVENANCE, Provenance
from tests.conftest import SMALL, Command, call
from tests.reading import verified
from tests.synthetic import Shown, write_recording


class _Process(NamedTuple):
    pid: int
    usedGpuMemory: int | None  # noqa: N815 (NVML's word)


class _Nvml(ModuleType):
    """NVML of one GPU, under the names of its documentation; `told` is by the last word of a query's name.

    without  names that this version of the bindings does not have
    """

    NVML_CLOCK_SM, NVML_CLOCK_MEM, NVML_TEMPERATURE_GPU = 1, 2, 0

    class NVMLError(Exception):
        """As the bindings have it."""

    def __init__(self, told: dict[str, Any], without: tuple[str, ...] = ()) -> None:
        super().__init__("pynvml")
        self.nvmlInit = self.nvmlShutdown = lambda: None
        self.nvmlDeviceGetCount = lambda: 1
        self.nvmlDeviceGetHandleByIndex = lambda index: f"handle {index}"
        self._told = told
        queries: dict[str, Callable[..., Any]] = {
            "nvmlDeviceGetClockInfo": lambda handle, of: self._tell({1: "sm", 2: "memory"}[of]),
            "nvmlDeviceGetPowerUsage": lambda handle: self._tell("power"),
            "nvmlDeviceGetTemperature": lambda handle, sensor: self._tell(f"temperature {sensor}"),
            "nvmlDeviceGetCurrentClocksEventReasons": lambda handle: self._tell("reasons"),
            "nvmlDeviceGetCurrentClocksThrottleReasons": lambda handle: self._tell("older reasons"),
            "nvmlDeviceGetUtilizationRates": lambda handle: SimpleNamespace(gpu=self._tell("busy"), memory=0),
            "nvmlDeviceGetComputeRunningProcesses": lambda handle: self._tell("compute"),
            "nvmlDeviceGetGraphicsRunningProcesses": lambda handle: [],
        }
        for name, query in queries.items():
            if name not in without:
                setattr(self, name, query)

    def _tell(self, what: str) -> Any:
        if isinstance(found := self._told[what], str):
            raise self.NVMLError(found)
        return found


_H100 = {
    "sm": 1755, "memory": 2619, "power": 412_000, "temperature 0": 55, "reasons": 0x4, "older reasons": 0x1, "busy": 98,
    "compute": [_Process(os.getpid(), 500), _Process(1, 70)],
}  # fmt: skip
_ALL = {
    "sm_clock_mhz": 1755, "memory_clock_mhz": 2619, "power_mw": 412_000, "temperature_c": 55, "throttle_reasons": 4,
    "utilisation_percent": 98,
}  # fmt: skip


@pytest.mark.parametrize(
    ("told", "without", "found", "not_known"),
    [
        ({}, (), _ALL, {}),
        # a GPU that is cut into parts tells no utilisation
        (
            {"busy": "Not Supported"}, (), {k: v for k, v in _ALL.items() if k != "utilisation_percent"},
            {"utilisation_percent": "NVML: Not Supported"},
        ),
        ({}, ("nvmlDeviceGetCurrentClocksEventReasons",), {**_ALL, "throttle_reasons": 1}, {}),
        ({"reasons": "Function Not Found"}, (), {**_ALL, "throttle_reasons": 1}, {}),
        (
            {"reasons": "GPU is lost", "older reasons": "GPU is lost", "power": "GPU is lost"}, (),
            {k: v for k, v in _ALL.items() if k not in ("throttle_reasons", "power_mw")},
            {"throttle_reasons": "NVML: GPU is lost", "power_mw": "NVML: GPU is lost"},
        ),
        (
            {}, ("nvmlDeviceGetPowerUsage",), {k: v for k, v in _ALL.items() if k != "power_mw"},
            {"power_mw": "not in this version of the bindings"},
        ),
    ],
)  # fmt: skip
def test_what_a_gpu_tells(
    told: dict[str, Any],
    without: tuple[str, ...],
    found: dict[str, int],
    not_known: dict[str, str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Read each quantity by itself: what one query does not tell has a reason, and the others are told."""
    monkeypatch.setitem(sys.modules, "pynvml", _Nvml(_H100 | told, without))
    with Gpus(hidden=True) as gpus:
        values, reasons = gpus.hardware(0)
    assert values == found
    assert reasons.keys() == not_known.keys()
    assert all(reasons[name].startswith(why) for name, why in not_known.items())


def _machine(root: Path, *, khz: int | None, mhz: float | None, ticks: int = 0) -> Path:
    usable = sorted(os.sched_getaffinity(0))
    (root / "proc").mkdir(parents=True, exist_ok=True)
    (root / "proc/stat").write_text(f"cpu  {ticks} 0 0 5 0 0 0 0 0 0\ncpu0 1 2 3\n")
    listed = "".join(f"processor\t: {cpu}\n" + (f"cpu MHz\t\t: {mhz + cpu}\n" if mhz else "") for cpu in usable)
    (root / "proc/cpuinfo").write_text(listed)
    for cpu in usable if khz else ():
        scaling = root / f"sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq"
        scaling.parent.mkdir(parents=True, exist_ok=True)
        scaling.write_text(f"{khz}\n")
    return root


def test_the_rate_of_cpus(tmp_path: Path) -> None:
    """Read the kernel's scaling rate; where it has none, the list of processors; else say that it shows none."""
    usable = sorted(os.sched_getaffinity(0))
    scaled = Cpus(_machine(tmp_path / "a", khz=3_100_000, mhz=2600.0))
    listed = Cpus(_machine(tmp_path / "b", khz=None, mhz=2600.0))
    silent = Cpus(_machine(tmp_path / "c", khz=None, mhz=None))
    nothing = Cpus(tmp_path / "d")
    assert scaled.clock_mhz() == pytest.approx(3100)
    assert listed.clock_mhz() == pytest.approx(2600 + sum(usable) / len(usable))
    assert all("shows no CPU frequency" in str(cpus.clock_mhz()) for cpus in (silent, nothing))
    assert "/proc/stat" in str(nothing.other_cpus())


def test_the_load_of_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Count the CPUs that others kept busy between two readings, without the process's own time."""
    monkeypatch.setattr("time.perf_counter", iter([10.0, 12.0, 13.0]).__next__)
    monkeypatch.setattr(os, "times", iter(SimpleNamespace(user=u, system=1.0) for u in (0.0, 1.0, 2.5)).__next__)
    ticks = os.sysconf("SC_CLK_TCK")
    cpus = Cpus(_machine(tmp_path, khz=None, mhz=None, ticks=100 * ticks))
    assert "from the second reading on" in str(cpus.other_cpus())
    _machine(tmp_path, khz=None, mhz=None, ticks=104 * ticks)
    assert cpus.other_cpus() == pytest.approx((4 - 1) / 2)
    _machine(tmp_path, khz=None, mhz=None, ticks=105 * ticks)
    assert cpus.other_cpus() == 0.0  # a tick is coarse: the process's own time may seem more than all


def _recorded(tmp_path: Path, nvml: _Nvml, monkeypatch: pytest.MonkeyPatch) -> Recording:
    monkeypatch.setitem(sys.modules, "pynvml", nvml)
    with Gpus(hidden=True) as gpus:
        sink = Sink(tmp_path / "run.mcap", compression="none")
        sampler = HardwareSampler(gpus, Cpus(_machine(tmp_path, khz=None, mhz=None)))
        writer = SampleWriter(sink, sampler)
        for phase, reasons, busy in (("warmup", 0x1, 0), ("timed", 0x4, 90), ("timed", 0x24, "Unknown Error")):
            nvml._told |= {"reasons": reasons, "busy": busy}
            sampler.phase = phase
            sampler.read_now()
        writer.drain()
    asked = RunConfiguration("s", "free-fall", 1, 0.01, 1)
    sink.attach(PROVENANCE, "application/json", Provenance("id", "", (), asked).to_json().encode())
    return open_recording(sink.finish("COMPLETE", "", last_step=0, peak_rss_bytes=0))


def test_readings_are_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write each reading with its phase, and each reason for a gap once."""
    recording = _recorded(tmp_path, _Nvml(dict(_H100)), monkeypatch)
    gpu, host = recording.hardware["gpu0"], recording.hardware["host"]
    assert gpu.phase == ("warmup", "timed", "timed")
    assert gpu.values["throttle_reasons"] == (0x1, 0x4, 0x24)
    assert gpu.values["utilisation_percent"] == (0, 90, None)
    assert gpu.values["other_processes"] == (1, 1, 1)
    assert gpu.not_known == ("utilisation_percent: NVML: Unknown Error",)
    assert "cpu_clock_mhz" not in host.values
    assert [why.partition(":")[0] for why in host.not_known] == ["cpu_clock_mhz"]
    assert gpu.longest_gap_s(int(gpu.time_ns[0]), int(gpu.time_ns[0]) + 10**10) == pytest.approx(10, abs=1)
    found = hardware_of(recording)["gpu0"]
    assert (found.readings, found.timed, found.longest_gap_s) == (3, 2, None)
    assert found.reasons == {"power cap": 1.0, "thermal slowdown by software": 0.5}
    assert found.values["sm_clock_mhz"] == (1755, 1755, 1755)
    assert found.values["utilisation_percent"] == (90, 90, 90)


def test_a_run_is_sampled(gsb_record: Command, tmp_path: Path) -> None:
    """Sample the host in every phase of a run, show it with --all, and keep the digests and rules of integrity."""
    done = gsb_record("--sim", "mujoco", "--n-env", 1, "--runs", 1, *SMALL, "--out", tmp_path)
    recording = verified(done.stdout.strip())
    trace = recording.hardware["host"]
    assert {"baseline", "init", "warmup", "timed", "capture"} <= set(trace.phase)
    assert "other_cpus" in trace.values
    assert "cpu_clock_mhz" in trace.values or any("cpu_clock_mhz" in why for why in trace.not_known)
    assert not examine(recording.path).of(Kind.clock)
    said = call("gsb-info", recording.path, "--all").stdout
    assert "hardware     host: " in said
    assert "of the timed phase, at most " in said


def _sample(**values: Any) -> tuple[str, str, Any]:
    made = message_class("gsb.v1.HardwareSample")(phase="timed", **values)
    return "/hardware/host", "gsb.v1.HardwareSample", made


def test_readings_that_cannot_be(tmp_path: Path) -> None:
    """Call a reading that no hardware has, and a clock that runs backwards, what they are."""
    for values in ({"utilisation_percent": 101}, {"cpu_clock_mhz": float("nan")}, {"other_cpus": -1.0}):
        path = write_recording(tmp_path, None, shown=Shown(raw=(_sample(monotonic_ns=1, **values),)))
        assert any("no hardware can have" in why for why in examine(path).of(Kind.stream)), values
    backwards = message_class("gsb.v1.HardwareSample")(monotonic_ns=-5, phase="timed")
    both = Shown(raw=(_sample(monotonic_ns=7), ("/hardware/host", "gsb.v1.HardwareSample", backwards)))
    assert examine(write_recording(tmp_path, None, shown=both)).of(Kind.clock) == (
        "the clock of /hardware/host runs backwards",
    )
