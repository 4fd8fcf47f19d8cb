"""Readings at a fixed rate from a thread of their own, while a run goes on in another: of memory, and of clock rates,
power, temperature and load of GPUs and CPUs."""

from __future__ import annotations

import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.schemas import topics
from gpusimbench.schemas.messages import enum_values

_R = TypeVar("_R")

MEMORY_INTERVAL_S = 0.01

BASELINE = "baseline"
"""The phase in which nothing of the engine exists."""

HARDWARE_INTERVAL_S = 0.2
_KHZ = 1e-3  # MHz
_TICKS = os.sysconf("SC_CLK_TCK")


class Reading(NamedTuple):
    """One reading for a recording: its topic, and the fields of its message by name; None where nothing told."""

    topic: str
    fields: dict[str, Any]


class Sampler(ABC, Generic[_R]):
    """Reads its sources every `interval_s` while running, and when told to.

    A reading that fails is counted, and the next is tried: one lost reading neither ends the run nor the sampling.

    what          is read, in a word
    phase         of the run, which readings are noted with; empty between phases
    failures      readings that failed
    last_failure  why the last of them did; empty when there were none
    """

    def __init__(self, what: str, interval_s: float) -> None:
        self._readings: list[_R] = []
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name=f"{what}-sampler", daemon=True)
        self._interval_s = interval_s
        self.what = what
        self.phase = ""
        self.failures = 0
        self.last_failure = ""

    def start(self) -> None:
        """Begin sampling."""
        self._thread.start()

    def stop(self) -> None:
        """End sampling; readings can still be taken."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def read_now(self) -> None:
        """Read every source now."""
        with self._lock:
            self._read()

    def take(self) -> list[_R]:
        """The readings since the last call, in order of time."""
        with self._lock:
            readings, self._readings = self._readings, []
        return readings

    @abstractmethod
    def _read(self) -> None:
        """Append readings of every source to `_readings`; the lock is held."""

    def _loop(self) -> None:
        while not self._stop.wait(self._interval_s):
            self.read_now()

    def _try(self, source: str, read: Callable[[], None]) -> None:
        try:
            read()
        except Exception as error:  # whatever a driver raises: the thread must go on
            self.failures += 1
            self.last_failure = f"{source}: {type(error).__name__}: {' '.join(str(error).split())}"


@dataclass
class _Alike:
    """Readings of one topic that are equal in all but the clock to the last that was kept.

    kept    fields of the reading that was kept, without the clock
    latest  all fields of the latest reading, None where none followed the one that was kept
    count   readings that followed it
    """

    kept: dict[str, Any]
    latest: dict[str, Any] | None = None
    count: int = 0


class MemorySampler(Sampler[Reading]):
    """Reads host and GPU memory at 100 Hz while running, and at checkpoints when told to.

    Of readings in a row that are equal in all but the clock, the first and the last are kept: GPU memory changes some
    tens of times in a run, and hours of readings would otherwise be more than what a timed run records besides.

    allocator  of the engine on GPU 0: bytes in use and their peak; read at checkpoints alone, since engines do not
               promise that another thread may ask
    topics     that readings are of
    """

    message = "gsb.v1.MemorySample"
    metadata: ClassVar = {
        "unit": "byte",
        "rate": "100 Hz and at checkpoints; of equal readings in a row, the first and last",
    }

    def __init__(self, gpus: Gpus) -> None:
        import psutil

        super().__init__("memory", MEMORY_INTERVAL_S)
        self._process = psutil.Process()
        self._host_total = psutil.virtual_memory().total
        self._gpus = gpus
        of_gpu = [topics.gpu_memory(i, of) for i in range(len(gpus)) for of in ("device", "process", "allocator")]
        self.topics = [topics.MEMORY_HOST, *of_gpu]
        self._sources = enum_values("gsb.v1.MemorySource")
        self._alike: dict[str, _Alike] = {}
        self.allocator: Callable[[], tuple[int, int] | None] | None = None

    def checkpoint(self, name: str) -> None:
        """Read every source now, under the name of a checkpoint of the protocol."""
        with self._lock:
            self._read(name)

    def take(self) -> list[Reading]:
        """The readings since the last call, in order of time."""
        with self._lock:
            for topic in self._alike:
                self._end_of_alike(topic)
        return sorted(super().take(), key=lambda reading: reading.fields["monotonic_ns"])

    def _read(self, checkpoint: str = "") -> None:
        now = time.perf_counter_ns()
        self._try("host", partial(self._read_host, now, checkpoint))
        for index in range(len(self._gpus)):
            self._try(f"gpu{index}", partial(self._read_gpu, index, now, checkpoint))
        if checkpoint and self.allocator is not None and len(self._gpus):
            self._try("allocator", partial(self._read_allocator, self.allocator, now, checkpoint))

    def _read_host(self, now: int, checkpoint: str) -> None:
        used = self._process.memory_info().rss
        self._add(topics.MEMORY_HOST, "HOST_RSS", 0, now, used, self._host_total, checkpoint)

    def _read_gpu(self, index: int, now: int, checkpoint: str) -> None:
        used, total = self._gpus.device_memory(index)
        found = self._gpus.processes(index, before_engine=self.phase == BASELINE)
        self._add(
            topics.gpu_memory(index, "device"), "GPU_DEVICE", index, now, used, total, checkpoint,
            other_processes=found.others, other_bytes=found.other_bytes,
            reserved_bytes=self._gpus.reserved_memory(index) if checkpoint else None,
        )  # fmt: skip
        if found.own_bytes is not None:
            self._add(
                topics.gpu_memory(index, "process"), "GPU_PROCESS", index, now, found.own_bytes, total, checkpoint
            )

    def _read_allocator(self, read: Callable[[], tuple[int, int] | None], now: int, checkpoint: str) -> None:
        found = read()
        if found is None:
            return
        used, peak = found
        self._add(topics.gpu_memory(0, "allocator"), "GPU_ALLOCATOR", 0, now, used, 0, checkpoint)
        self._add(topics.gpu_memory(0, "allocator"), "GPU_ALLOCATOR", 0, now, peak, 0, f"peak until {checkpoint}")

    def _add(
        self,
        topic: str,
        source: str,
        device: int,
        now: int,
        used: int,
        total: int,
        checkpoint: str,
        **others: int | None,
    ) -> None:
        fields = {
            "source": self._sources[f"MEMORY_SOURCE_{source}"], "device": device, "monotonic_ns": now,
            "used_bytes": used, "total_bytes": total, "phase": self.phase, "checkpoint": checkpoint, **others,
        }  # fmt: skip
        values = {name: value for name, value in fields.items() if name != "monotonic_ns"}
        alike = self._alike.get(topic)
        if alike and alike.kept == values and not checkpoint:
            alike.latest = fields
            alike.count += 1
            return
        self._end_of_alike(topic)
        self._alike[topic] = _Alike(values)
        self._readings.append(Reading(topic, fields))

    def _end_of_alike(self, topic: str) -> None:
        alike = self._alike.get(topic)
        if alike and alike.latest:
            self._readings.append(Reading(topic, {**alike.latest, "omitted_readings": alike.count - 1}))
            alike.latest, alike.count = None, 0


class Cpus:
    """The CPUs that this process may use.

    root  of the file system that the kernel shows /proc and /sys in
    """

    def __init__(self, root: Path = Path("/")) -> None:
        self._usable = sorted(os.sched_getaffinity(0))
        self._scaling = [root / f"sys/devices/system/cpu/cpu{cpu}/cpufreq/scaling_cur_freq" for cpu in self._usable]
        self._cpuinfo, self._stat = root / "proc/cpuinfo", root / "proc/stat"
        self._before: tuple[float, float] | None = None

    def clock_mhz(self) -> float | str:
        """Mean clock rate of the usable CPUs [MHz], or why it is not known."""
        rates = []
        for file in self._scaling:
            try:
                rates.append(int(file.read_text()) * _KHZ)
            except (OSError, ValueError):
                break
        rates = rates if len(rates) == len(self._usable) else self._listed()
        if not rates:
            return "the kernel shows no CPU frequency, in /sys/devices/system/cpu/*/cpufreq or /proc/cpuinfo"
        return sum(rates) / len(rates)

    def _listed(self) -> list[float]:
        found: dict[int, float] = {}
        try:
            for line in self._cpuinfo.read_text().splitlines():
                name, _, value = line.partition(":")
                if name.strip() == "processor":
                    found[int(value)] = 0.0
                elif name.strip() == "cpu MHz":
                    found[next(reversed(found))] = float(value)
        except (OSError, ValueError, StopIteration):
            return []
        rates = [found.get(cpu, 0.0) for cpu in self._usable]
        return rates if all(rates) else []

    def other_cpus(self) -> float | str:
        """CPUs that other processes kept busy since the last call, on the mean, or why it is not known."""
        try:
            user, nice, system, _, _, irq, softirq = map(int, self._stat.read_text().split("\n", 1)[0].split()[1:8])
        except (OSError, ValueError):
            return "the kernel does not show the CPUs' time in /proc/stat"
        own = os.times()
        others = (user + nice + system + irq + softirq) / _TICKS - own.user - own.system
        before, now = self._before, time.perf_counter()
        self._before = (now, others)
        if before is None or now <= before[0]:
            return "the load of other processes is known from the second reading on"
        return max(0.0, (others - before[1]) / (now - before[0]))


class HardwareSampler(Sampler[Reading]):
    """Reads the host and the GPUs at 5 Hz while running, and when told to.

    What was not told is left out of a reading, and one sentence says why, in the first reading that it is true of.

    topics  that readings are of
    """

    message = "gsb.v1.HardwareSample"
    metadata: ClassVar = {"rate": "5 Hz"}

    def __init__(self, gpus: Gpus, cpus: Cpus | None = None) -> None:
        super().__init__("hardware", HARDWARE_INTERVAL_S)
        self._gpus = gpus
        self.topics = [topics.HARDWARE_HOST, *map(topics.gpu_hardware, range(len(gpus)))]
        self._cpus = cpus or Cpus()
        self._cpus.other_cpus()  # from here on the load is counted
        self._said: dict[tuple[str, str], str] = {}

    def _read(self) -> None:
        self._try("host", self._read_host)
        for index in range(len(self._gpus)):
            self._try(f"gpu{index}", partial(self._read_gpu, index))

    def _read_host(self) -> None:
        now = time.perf_counter_ns()
        found = {"cpu_clock_mhz": self._cpus.clock_mhz(), "other_cpus": self._cpus.other_cpus()}
        told = {name: value for name, value in found.items() if not isinstance(value, str)}
        self._add(topics.HARDWARE_HOST, 0, now, told, {n: v for n, v in found.items() if isinstance(v, str)})

    def _read_gpu(self, index: int) -> None:
        now = time.perf_counter_ns()
        found, not_known = self._gpus.hardware(index)
        told: dict[str, float] = dict(found)
        others = self._gpus.processes(index, before_engine=self.phase == BASELINE).others
        if others is None:
            not_known["other_processes"] = "NVML does not tell the recording process from others"
        else:
            told["other_processes"] = others
        self._add(topics.gpu_hardware(index), index, now, told, not_known)

    def _add(self, topic: str, device: int, now: int, told: dict[str, float], not_known: dict[str, str]) -> None:
        fresh = {name: why for name, why in not_known.items() if self._said.get((topic, name)) != why}
        self._said.update({(topic, name): why for name, why in fresh.items()})
        reasons = [f"{name}: {why}" for name, why in fresh.items()]
        fields = {"device": device, "monotonic_ns": now, "phase": self.phase, "not_known": reasons, **told}
        self._readings.append(Reading(topic, fields))
