"""What a GPU says of why its clocks are not higher, as NVML numbers it (nvmlClocksEventReasons)."""

from __future__ import annotations

from collections.abc import Iterable

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


def throttled_share(readings: Iterable[float]) -> float | None:
    """Share of readings (masks of bits) in which heat or power held the clocks down; None where there are none."""
    held = [bool(int(mask) & THROTTLING) for mask in readings]
    return sum(held) / len(held) if held else None


def reasons_of(readings: Iterable[float]) -> dict[str, float]:
    """Share of readings by each reason that any of them has, in the order of the bits."""
    masks = [int(mask) for mask in readings]
    shares = {name: sum(bool(mask & bit) for mask in masks) / len(masks) for bit, name in REASONS.items() if masks}
    return {name: share for name, share in shares.items() if share}
