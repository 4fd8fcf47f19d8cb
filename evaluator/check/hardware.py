"""What the hardware's readings of the timed phase, or of the whole run, come to; and why a GPU held its clocks down."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gpusimbench.evaluator.read.evidence import HardwareTrace
from gpusimbench.evaluator.read.recording import Recording

REASONS = {
    0x1: "idle",
    0x2: "application clocks",
    0x4: "power cap",
    0x8: "hardware slowdown",
    0x10: "sync boost",
    0x20: "thermal slowdown by software",
    0x40: "thermal slowdown by hardware",
    0x80: "power brake",
    0x100: "display clock",
}
"""Bits, and what they mean."""

THROTTLING = 0x4 | 0x8 | 0x20 | 0x40 | 0x80
"""The bits that mean that heat or power holds clocks down: the same code may run faster another time."""

_MASK = "throttle_reasons"


def throttled_share(readings: Iterable[float]) -> float | None:
    """Share of readings (masks of bits) in which heat or power held the clocks down; None where there are none."""
    held = [bool(int(mask) & THROTTLING) for mask in readings]
    return sum(held) / len(held) if held else None


def reasons_of(readings: Iterable[float]) -> dict[str, float]:
    """Share of readings by each reason that any of them has, in the order of the bits."""
    masks = [int(mask) for mask in readings]
    shares = {name: sum(bool(mask & bit) for mask in masks) / len(masks) for bit, name in REASONS.items() if masks}
    return {name: share for name, share in shares.items() if share}


@dataclass(frozen=True)
class Hardware:
    """Readings of the host or of a GPU.

    readings      of all phases
    timed         how many of them are of the timed phase
    longest_gap_s longest time within the timed phase without a reading [s]; None where nothing was timed
    values        least, mean and largest of each field, of the timed phase, or of all phases where nothing was timed
    reasons       share of the same readings by each reason for lower clocks; None where the GPU does not tell reasons
    not_known     what readings lack and why
    """

    readings: int
    timed: int
    longest_gap_s: float | None
    values: dict[str, tuple[float, float, float]]
    reasons: dict[str, float] | None
    not_known: tuple[str, ...]


def hardware_of(recording: Recording) -> dict[str, Hardware]:
    """Readings of the hardware, by where they are of: "host", "gpu0", ..."""
    return {source: _summary(recording, trace) for source, trace in recording.hardware.items()}


def stepping_on(recording: Recording) -> str:
    """Where the readings of what the simulator stepped on are of: "host" or "gpu0"."""
    return "host" if recording.simulation is None or recording.simulation.device == "cpu" else "gpu0"


def longest_gap_s(recording: Recording) -> float | None:
    """The longest time within the timed phase without a reading of what the simulator stepped on [s].

    All of the phase where nothing was sampled; None where nothing was timed.
    """
    timing = recording.timing.get("timed")
    if timing is None:
        return None
    trace = recording.hardware.get(stepping_on(recording))
    return trace.longest_gap_s(int(timing.start_ns[0]), int(timing.end_ns[-1])) if trace else timing.elapsed_s


def timed_throttled_share(recording: Recording) -> float | None:
    """Share of the timed phase's readings in which heat or power held the GPU's clocks down; None where no reading
    tells."""
    trace = recording.hardware.get(stepping_on(recording))
    return throttled_share(trace.of(_MASK, "timed")) if trace else None


def _summary(recording: Recording, trace: HardwareTrace) -> Hardware:
    timing = recording.timing.get("timed")
    timed = sum(phase == "timed" for phase in trace.phase)
    values, masks = {}, list[float]()
    for name, column in trace.values.items():
        told = trace.of(name, "timed") if timed else [value for value in column if value is not None]
        if name == _MASK:
            masks = told
        elif told:
            values[name] = (min(told), sum(told) / len(told), max(told))
    gap = trace.longest_gap_s(int(timing.start_ns[0]), int(timing.end_ns[-1])) if timing else None
    return Hardware(
        len(trace.time_ns), timed, gap, values, reasons_of(masks) if _MASK in trace.values else None, trace.not_known
    )
