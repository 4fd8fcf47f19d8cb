"""Clock rates, power, temperature and load of GPUs and CPUs during a run, from a thread of their own."""

from __future__ import annotations

import os
import time
from functools import partial
from pathlib import Path
from typing import ClassVar

from gpusimbench.recorder.probes.gpu import Gpus
from gpusimbench.recorder.probes.memory import BASELINE
from gpusimbench.recorder.probes.sampling import Reading, Sampler
from gpusimbench.schemas import topics

INTERVAL_S = 0.2
_KHZ = 1e-3  # MHz
_TICKS = os.sysconf("SC_CLK_TCK")


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
        super().__init__("hardware", INTERVAL_S)
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
