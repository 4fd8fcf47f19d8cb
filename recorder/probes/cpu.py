"""How fast the CPUs could run: their clock rate as the kernel shows it, and the load of other processes."""

from __future__ import annotations

import os
import time
from pathlib import Path

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
