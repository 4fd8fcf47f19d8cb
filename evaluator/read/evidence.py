"""Evidence of a run: counts, buffers that were run into and actions that were applied show that its steps did their
work; clock rates, power, temperature and load show how fast the hardware could run."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.read.messages import Messages
from gpusimbench.schemas import topics
from gpusimbench.schemas.checks import MAX_COUNT
from gpusimbench.schemas.provenance import OverflowBit

_MAX_VALUE = float(1 << 53)  # up to here every whole number is a double
_ROUNDING = 1e-9  # of a mean against the largest of what it is a mean of
_SHA256 = re.compile(r"[0-9a-f]{64}|")

_WHOLE = (
    "sm_clock_mhz", "memory_clock_mhz", "power_mw", "temperature_c", "throttle_reasons", "utilisation_percent",
    "other_processes",
)  # fmt: skip
"""Whole numbers of a GPU's reading, by field of a HardwareSample."""

_REAL = ("cpu_clock_mhz", "other_cpus")
"""The same of the host's, as floating-point numbers."""

_MOST_REAL = 1e9
_PERCENT = 100


@dataclass(frozen=True)
class StepCounts:
    """One counter of one phase; a row is the step that led to `steps`.

    steps      simulator step of each row, shape [row]
    mean       over environments, shape [row]
    p95        95th percentile over environments, shape [row]
    max        largest environment, shape [row]
    """

    steps: NDArray[np.int64]
    mean: NDArray[np.float64]
    p95: NDArray[np.float64]
    max: NDArray[np.float64]


@dataclass(frozen=True)
class Overflows:
    """Buffers and limits that the steps of a phase ran into.

    steps   simulator step of each row, shape [row]; a row stands for all steps since the row before
    bits    or of all environments, shape [row]
    envs    environments with any bit, shape [row]
    stride  steps between two rows
    """

    steps: NDArray[np.int64]
    bits: NDArray[np.uint32]
    envs: NDArray[np.int64]
    stride: int

    def rows_of(self, bit: int) -> NDArray[np.bool_]:
        """In which rows a bit fired, shape [row]."""
        return np.asarray((self.bits >> np.uint32(bit)) & np.uint32(1) == 1)

    def fatal(self, described: Sequence[OverflowBit]) -> tuple[str, int] | None:
        """Name and step of the first fatal bit that fired, None where none did."""
        for bit in described:
            fired = self.rows_of(bit.bit)
            if bit.fatal and fired.any():
                return bit.name, int(self.steps[np.argmax(fired)])
        return None


@dataclass(frozen=True)
class ActionStream:
    """Actions that a phase applied, by their generator.

    generator                   with all that it depends on, JSON
    first_step, steps           of the phase
    first_sha256, last_sha256   of the actions of its first and last step [hex]
    verified                    the engine was asked what it applied in the last step, and it was this
    """

    generator: str
    first_step: int
    steps: int
    first_sha256: str
    last_sha256: str
    verified: bool


def read_counts(messages: Messages) -> dict[str, dict[str, StepCounts]]:
    """Counters by phase and name."""
    found: dict[str, dict[str, StepCounts]] = {}
    for topic in messages.topics("/count/"):
        parsed = topics.parse_count(topic)
        parts = messages.read(topic, "gsb.v1.StepCounts") if parsed else []
        if parsed is None or not parts:
            continue
        for part in parts:
            if not len(part.mean) == len(part.p95) == len(part.max):
                raise messages.damaged(f"{topic} has means, percentiles and maxima of different numbers of steps")
        steps = _steps(messages, topic, [(p, len(p.mean)) for p in parts])
        mean, p95, largest = (
            np.concatenate([np.fromiter(getattr(p, name), np.float64, len(getattr(p, name))) for p in parts])
            for name in ("mean", "p95", "max")
        )
        values = np.stack([mean, p95, largest])
        if not np.isfinite(values).all() or (values < 0).any() or (values > _MAX_VALUE).any():
            raise messages.damaged(f"{topic} counts what cannot be counted: not finite, negative or beyond 2^53")
        if (mean > largest * (1 + _ROUNDING)).any() or (p95 > largest).any():
            raise messages.damaged(f"{topic} has a mean or a percentile above its maximum")
        if len(steps):
            found.setdefault(parsed[0], {})[parsed[1]] = StepCounts(steps, mean, p95, largest)
    return found


def read_overflows(messages: Messages, *, n_env: int) -> dict[str, Overflows]:
    """Overflow bits by phase; a phase without a row is left out."""
    found = {}
    for topic in messages.topics("/overflow/"):
        parts = messages.read(topic, "gsb.v1.Overflow")
        if any(len(p.bits) != len(p.envs) for p in parts):
            raise messages.damaged(f"{topic} has bits and environments of different numbers of steps")
        steps = _steps(messages, topic, [(p, len(p.bits)) for p in parts])
        if not len(steps):
            continue
        bits = np.concatenate([np.fromiter(p.bits, np.uint32, len(p.bits)) for p in parts])
        envs = np.concatenate([np.fromiter(p.envs, np.int64, len(p.envs)) for p in parts])
        if (envs > n_env).any() or ((envs == 0) != (bits == 0)).any():
            raise messages.damaged(f"{topic} has bits without environments, or more environments than there are")
        found[topic.removeprefix("/overflow/")] = Overflows(steps, bits, envs, max(int(p.stride) for p in parts))
    return found


def read_action_streams(messages: Messages, *, n_env: int) -> dict[str, ActionStream]:
    """The actions that were applied, by phase."""
    found = {}
    for topic in messages.topics("/action_stream/"):
        parts = messages.read(topic, "gsb.v1.ActionStream")
        if not parts:
            continue
        if len(parts) > 1:
            raise messages.damaged(f"{topic} describes {len(parts)} streams, a phase has one")
        (part,) = parts
        if part.envs != n_env or max(part.first_step, part.steps) > MAX_COUNT:
            raise messages.damaged(f"{topic} is of {part.envs} environments and {part.steps} steps, which cannot be")
        if not all(_SHA256.fullmatch(digest) for digest in (part.first_sha256, part.last_sha256)):
            raise messages.damaged(f"{topic} has a digest that is no SHA-256")
        found[topic.removeprefix("/action_stream/")] = ActionStream(
            part.generator, part.first_step, part.steps, part.first_sha256, part.last_sha256, part.verified
        )
    return found


def _steps(messages: Messages, topic: str, parts: Sequence[tuple[Any, int]]) -> NDArray[np.int64]:
    # the step of each row; rows that are not in order would make "first" and "last" meaningless
    found = []
    for part, rows in parts:
        if part.first_step + rows * part.stride > MAX_COUNT or (rows > 1 and part.stride < 1):
            raise messages.damaged(f"{topic} has steps that cannot be")
        found.append(part.first_step + np.arange(rows, dtype=np.int64) * part.stride)
    steps = np.concatenate(found) if found else np.empty(0, dtype=np.int64)
    if (np.diff(steps) <= 0).any():
        raise messages.damaged(f"the steps of {topic} are not in order")
    return steps


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
        columns: dict[str, list[float | None]] = {name: [] for name in (*_WHOLE, *_REAL)}
        for sample in messages.each(topic, "gsb.v1.HardwareSample"):
            if sample.utilisation_percent > _PERCENT or not all(_plausible(getattr(sample, name)) for name in _REAL):
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
