"""Radar scaling."""

from __future__ import annotations

import pytest

from gpusimbench.evaluator.metrics.radar import Axis, SimulatorResult, radar

SLOW = SimulatorResult("slow", 1e3, 2**8, 2.0, 5.0, 0.0, 0.0)
MIDDLE = SimulatorResult("middle", 2e3, 2**9, 3.0, 3.0, 0.0, 1.0)
FAST = SimulatorResult("fast", 5e3, 2**12, 6.0, 1.0, 0.0, 4.0)


def test_scaling() -> None:
    """Scale to 0 .. 1 with 1 the best, parallelism as log2."""
    values = radar([SLOW, MIDDLE, FAST]).values
    assert [values[n][Axis.THROUGHPUT] for n in ("slow", "middle", "fast")] == [0.0, 0.25, 1.0]
    assert [values[n][Axis.PARALLELISM] for n in ("slow", "middle", "fast")] == [0.0, 0.25, 1.0]
    assert [values[n][Axis.MEMORY] for n in ("slow", "middle", "fast")] == [1.0, 0.75, 0.0]
    assert [values[n][Axis.EMD_TO_REAL] for n in ("slow", "middle", "fast")] == [0.0, 0.5, 1.0]
    assert [values[n][Axis.RUN_TO_RUN] for n in ("slow", "middle", "fast")] == [1.0, 0.75, 0.0]


def test_equal_axis_is_flagged() -> None:
    """Give everyone 1.0 on an axis without differences and flag it."""
    result = radar([SLOW, MIDDLE, FAST])
    assert {v[Axis.PARALLEL] for v in result.values.values()} == {1.0}
    assert result.all_equal == {Axis.PARALLEL}


def test_missing_values_stay_missing() -> None:
    """Leave missing values out of the scale and of the result."""
    result = radar([SLOW, FAST, SimulatorResult("partial", fps=3e3)])
    assert result.values["partial"][Axis.THROUGHPUT] == 0.5
    assert result.values["partial"][Axis.MEMORY] is None
    assert result.mean("partial") is None
    assert result.mean("fast") == pytest.approx((1 + 1 + 0 + 1 + 1 + 0) / 6)


def test_axis_that_nobody_measured() -> None:
    """Call an axis without any value missing, not equal."""
    result = radar([SimulatorResult("a", fps=1.0), SimulatorResult("b", fps=2.0)])
    assert result.values["a"][Axis.MEMORY] is None
    assert result.all_equal == frozenset()


def test_refuses_a_single_simulator() -> None:
    """Refuse to compare one with itself."""
    with pytest.raises(ValueError, match="at least two"):
        radar([SLOW])


def test_refuses_repeated_names() -> None:
    """Refuse two results of one name."""
    with pytest.raises(ValueError, match="more than one result named slow"):
        radar([SLOW, SLOW])


@pytest.mark.parametrize(
    "figures", [{"fps": float("nan")}, {"memory_gb": -1.0}, {"n_max": 0}, {"w1_real": float("inf")}]
)
def test_result_refuses(figures: dict[str, float]) -> None:
    """Refuse figures that no measurement gives."""
    with pytest.raises(ValueError, match=next(iter(figures))):
        SimulatorResult("x", **figures)
