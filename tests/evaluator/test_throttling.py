"""What a GPU says of its clocks, by NVML's own numbers."""

from __future__ import annotations

import pynvml
import pytest

from gpusimbench.evaluator.check.hardware import REASONS, THROTTLING, reasons_of, throttled_share

NAMES = {
    "GpuIdle": "idle",
    "ApplicationsClocksSetting": "application clocks",
    "SwPowerCap": "power cap",
    "HwSlowdown": "hardware slowdown",
    "SyncBoost": "sync boost",
    "SwThermalSlowdown": "thermal slowdown by software",
    "HwThermalSlowdown": "thermal slowdown by hardware",
    "HwPowerBrakeSlowdown": "power brake",
    "DisplayClockSetting": "display clock",
}
BITS = {name: int(getattr(pynvml, f"nvmlClocksEventReason{theirs}")) for theirs, name in NAMES.items()}


def test_every_bit_of_nvml_has_its_name() -> None:
    """Name each bit that NVML knows, in the order of the bits; heat and power are what hold clocks down."""
    assert {name: bit for bit, name in REASONS.items()} == BITS
    assert list(REASONS) == sorted(REASONS)
    assert sum(REASONS) == pynvml.nvmlClocksEventReasonAll
    held = [name for bit, name in REASONS.items() if THROTTLING & bit]
    assert held == [name for name in BITS if "power" in name or "slowdown" in name]
    assert sum(BITS[name] for name in held) == THROTTLING


@pytest.mark.parametrize(
    ("names", "share"),
    [
        ([], None),
        ([[]], 0.0),
        ([["idle"], ["sync boost", "display clock"], ["application clocks"]], 0.0),
        ([["power cap"], ["idle"], ["idle", "thermal slowdown by software"], []], 0.5),
        ([["power brake"], ["hardware slowdown", "thermal slowdown by hardware"], ["idle"]], 2 / 3),
    ],
)
def test_shares_of_readings(names: list[list[str]], share: float | None) -> None:
    """Count the readings that heat or power held down, and the readings with each reason; none tells nothing."""
    readings = [float(sum(BITS[name] for name in some)) for some in names]
    assert throttled_share(readings) == share
    counts = {name: sum(name in some for some in names) for name in BITS}
    assert reasons_of(readings) == {name: count / len(names) for name, count in counts.items() if count}
    assert list(reasons_of(readings)) == [name for name, count in counts.items() if count]
