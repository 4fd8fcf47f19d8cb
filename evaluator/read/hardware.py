"""How fast the hardware could run while a run went on: clock rates, power, temperature, load."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.messages import Messages

WHOLE = (
    "sm_clock_mhz", "memory_clock_mhz", "power_mw", "temperature_c", "throttle_reasons", "utilisation_percent",
    "other_processes",
)  # fmt: skip
"""Whole numbers of a GPU's reading, by field of a HardwareSample."""

REAL = ("cpu_clock_mhz", "other_cpus")
"""The same of the host's, as floating-point numbers."""

_MOST_REAL = 1e9
_PERCENT = 100


@dataclass(frozen=True)
class HardwareTrace:
    """Readings of the host or of a GPU, in order of time.

    time_ns    host's monotonic clock, shape [sample]
    phase      of the run, one per sample
    values     by field of a HardwareSample, one per sample, None where it was not told; a field that no sample tells is
               left out
    not_known  what readings lack and why, each once
    """

    time_ns: NDArray[np.int64]
    phase: tuple[str, ...]
    values: dict[str, tuple[float | None, ...]]
    not_known: tuple[str, ...]

    def of(self, name: str, phase: str) -> list[float]:
        """The values of a field that readings of a phase tell."""
        found = zip(self.phase, self.values.get(name, ()), strict=False)
        return [value for there, value in found if there == phase and value is not None]

    def longest_gap_s(self, start_ns: int, end_ns: int) -> float:
        """The longest time between two clocks without a reading [s]."""
        inside = self.time_ns[(self.time_ns >= start_ns) & (self.time_ns <= end_ns)]
        return float(np.diff(np.concatenate([[start_ns], inside, [end_ns]])).max()) * 1e-9


def read_hardware(messages: Messages) -> dict[str, HardwareTrace]:
    """Readings by where they are of: "host", "gpu0", "gpu1", ..."""
    found = {}
    for topic in messages.topics("/hardware/"):
        times, phases, reasons = list[int](), list[str](), dict[str, None]()
        columns: dict[str, list[float | None]] = {name: [] for name in (*WHOLE, *REAL)}
        for sample in messages.each(topic, "gsb.v1.HardwareSample"):
            if sample.utilisation_percent > _PERCENT or not all(_plausible(getattr(sample, name)) for name in REAL):
                raise messages.damaged(f"{topic} has a reading that no hardware can have")
            times.append(sample.monotonic_ns)
            phases.append(sample.phase)
            reasons.update(dict.fromkeys(sample.not_known))
            for name, column in columns.items():
                column.append(getattr(sample, name) if sample.HasField(name) else None)
        if times:
            told = {name: tuple(column) for name, column in columns.items() if any(v is not None for v in column)}
            found[topic.removeprefix("/hardware/")] = HardwareTrace(
                np.array(times, dtype=np.int64), tuple(phases), told, tuple(reasons)
            )
    return found


def _plausible(value: float) -> bool:
    return math.isfinite(value) and 0 <= value < _MOST_REAL
