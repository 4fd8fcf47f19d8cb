"""Radar: six axes on which simulators are compared, each scaled to 0 .. 1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class Axis(StrEnum):
    """Axes of the radar, in the order in which they are drawn."""

    THROUGHPUT = "throughput"
    PARALLELISM = "max parallelism"
    MEMORY = "memory"
    EMD_TO_REAL = "EMD to real"
    PARALLEL = "parallel variability"
    RUN_TO_RUN = "run-to-run variability"


LOWER_IS_BETTER = frozenset({Axis.MEMORY, Axis.EMD_TO_REAL, Axis.PARALLEL, Axis.RUN_TO_RUN})


@dataclass(frozen=True)
class SimulatorResult:
    """Figures of one simulator; None where one was not measured.

    name              as shown
    fps               throughput at n_max, simple bodies [env-steps/s]
    n_max             largest sustained number of envs, simple bodies
    memory_gb         peak memory increment at n_max, simple bodies [GB]
    w1_real           EMD to real [cm]
    parallel          parallel variability [cm]
    run_to_run        run-to-run variability [cm]
    fps_articulated   throughput at n_max_articulated, articulated robot [env-steps/s]
    n_max_articulated largest sustained number of envs, articulated robot
    barred            why its figures of simple bodies earn no pick, in words; empty where nothing speaks against it
    barred_articulated  the same of its figures of an articulated robot
    why_no_fps        why its throughput is missing or cannot be compared; empty where it is there
    """

    name: str
    fps: float | None = None
    n_max: int | None = None
    memory_gb: float | None = None
    w1_real: float | None = None
    parallel: float | None = None
    run_to_run: float | None = None
    fps_articulated: float | None = None
    n_max_articulated: int | None = None
    barred: str = ""
    barred_articulated: str = ""
    why_no_fps: str = ""

    def __post_init__(self) -> None:
        for field, value in vars(self).items():
            if value is None or isinstance(value, str):
                continue
            lowest = 1 if field.startswith("n_max") else 0
            if not (math.isfinite(value) and value >= lowest):
                raise ValueError(f"{self.name}: {field} must be finite and >= {lowest}: {value}")

    def axis_values(self) -> dict[Axis, float | None]:
        """Value on every radar axis, before scaling; parallelism as log2."""
        return {
            Axis.THROUGHPUT: self.fps,
            Axis.PARALLELISM: None if self.n_max is None else math.log2(self.n_max),
            Axis.MEMORY: self.memory_gb,
            Axis.EMD_TO_REAL: self.w1_real,
            Axis.PARALLEL: self.parallel,
            Axis.RUN_TO_RUN: self.run_to_run,
        }


@dataclass(frozen=True)
class Radar:
    """Scaled values, meaningful only within the simulators compared.

    values      by simulator, by axis: 1.0 best, 0.0 worst, None not measured
    all_equal   axes on which no two measured values differ: their 1.0 is no distinction
    """

    values: dict[str, dict[Axis, float | None]]
    all_equal: frozenset[Axis]

    def mean(self, name: str) -> float | None:
        """Mean over the six axes; None where one is missing, since fewer axes flatter."""
        values = [v for v in self.values[name].values() if v is not None]
        return sum(values) / len(Axis) if len(values) == len(Axis) else None


def radar(results: Sequence[SimulatorResult]) -> Radar:
    """Scale the six axes over the simulators compared (GPUSimBench definition).

        (x - min) / (max - min),  one minus that where lower is better;  parallelism as log2 first

    Raises:
        ValueError: fewer than two simulators, or two of the same name.
    """
    if len(results) < 2:
        raise ValueError(f"a radar compares at least two simulators, got {len(results)}")
    require_unique_names(results)
    scaled: dict[str, dict[Axis, float | None]] = {r.name: {} for r in results}
    all_equal = set()
    for axis in Axis:
        raw = {r.name: r.axis_values()[axis] for r in results}
        measured = [v for v in raw.values() if v is not None]
        low, high = min(measured, default=0.0), max(measured, default=0.0)
        if measured and low == high:
            all_equal.add(axis)
        for name, value in raw.items():
            scaled[name][axis] = None if value is None else _scale(value, low, high, axis)
    return Radar(scaled, frozenset(all_equal))


def require_unique_names(results: Sequence[SimulatorResult]) -> None:
    """Raise ValueError where two results bear the same name."""
    names = [r.name for r in results]
    repeated = sorted({n for n in names if names.count(n) > 1})
    if repeated:
        raise ValueError(f"more than one result named {', '.join(repeated)}")


def _scale(value: float, low: float, high: float, axis: Axis) -> float:
    if low == high:
        return 1.0
    if axis in LOWER_IS_BETTER:
        return (high - value) / (high - low)
    return (value - low) / (high - low)
