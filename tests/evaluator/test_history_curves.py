"""Curves of a history: what is marked, what a newest point could hide, and in which unit it is told."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from gpusimbench.evaluator.compare.finding import Change, Settings
from gpusimbench.evaluator.compare.history.curves import FACT, Curve, Sample, Shift, searched
from gpusimbench.evaluator.compare.history.words import visible
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.results.metrics import METRICS

FPS, HOST = METRICS["fps"], METRICS["host_memory_peak_increment"]
SETTINGS = Settings()
MB = 1e6


def curve(metric: Any, values: list[float], *, logs: bool = False, exact: bool = False, **more: Any) -> Curve:
    """A curve of values in the metric's unit, at points 10, 11, ..."""
    centers = [math.log(v * metric.per_unit) if logs else v * metric.per_unit for v in values]
    samples = tuple(Sample(10 + i, v, None, 3, c, exact) for i, (v, c) in enumerate(zip(values, centers, strict=True)))
    return Curve(metric, Axis.MEMORY if metric is HOST else Axis.THROUGHPUT, samples, logs, exact, **more)


def test_a_value_that_every_run_has_changes_for_certain() -> None:
    """Mark every other value as a fact, by what matters, in the unit of the quantity."""
    found = searched(curve(HOST, [100.0, 100.0, 200.0, 201.0, 150.0], exact=True), 0.05, SETTINGS)
    assert [(s.point, s.previous, s.change, s.before, s.after) for s in found.shifts] == [
        (12, 11, Change.REGRESSION, 100.0, 200.0),
        (13, 12, Change.SMALL, 200.0, 201.0),
        (14, 13, Change.IMPROVEMENT, 201.0, 150.0),
    ]
    assert [s.ratio for s in found.shifts] == pytest.approx([2.0, 1.005, 150 / 201])
    assert {(s.p_value, s.ci95) for s in found.shifts} == {(FACT, None)}
    assert (found.visible, found.sighted) == (None, None)


def test_a_value_that_begins_at_zero_has_no_ratio() -> None:
    """Give the amounts alone of a change from zero."""
    (shift,) = searched(curve(HOST, [0.0, 5.0], exact=True), 0.05, SETTINGS).shifts
    assert (shift.before, shift.after, shift.ratio, shift.change) == (0.0, 5.0, None, Change.REGRESSION)


def test_a_change_among_noise_is_told_by_geometric_means() -> None:
    """Give the levels, their ratio with an interval, and how far one more point would have to lie."""
    noise = np.exp(0.01 * np.random.default_rng(3).normal(size=12))
    values = (1000.0 * noise * np.where(np.arange(12) >= 8, 0.5, 1.0)).tolist()
    found = searched(curve(FPS, values, logs=True), 0.05, SETTINGS)
    (shift,) = found.shifts
    before, after = (math.exp(np.log(part).mean()) for part in (values[:8], values[8:]))
    assert (shift.point, shift.previous, shift.change) == (18, 17, Change.REGRESSION)
    assert (shift.before, shift.after, shift.ratio) == pytest.approx((before, after, after / before))
    assert shift.ci95[0] < 0.5 < shift.ci95[1]
    assert shift.ci95[1] / shift.ci95[0] < 1.05
    assert 0 < shift.p_value <= 0.05
    assert found.sighted is not None
    assert 1.02 < found.visible < found.sighted < 1.2
    further = searched(curve(FPS, [*values, after / found.visible * 0.999], logs=True), 0.05, SETTINGS)
    assert [one.point for one in further.shifts] == [18, 22]


def test_amounts_are_told_in_their_unit() -> None:
    """Give what would be visible of a quantity that may be zero in its unit, whatever its base unit is."""
    values = [0.0, 2.0, 1.0, 2.0, 0.0, 1.0]
    found = searched(curve(HOST, values), 0.05, SETTINGS)
    in_bytes = searched(curve(METRICS["distinct_runs"], [v * MB for v in values]), 0.05, SETTINGS)
    assert in_bytes.visible == pytest.approx(found.visible * MB)
    assert 4.0 < found.visible < 20.0
    assert visible(found).endswith(" MB")


@pytest.mark.parametrize(
    ("metric", "logs", "more", "why"),
    [
        (FPS, True, {"changes_missing": "too few"}, "too few"),
        (FPS, True, {"exact": True}, ""),
        (FPS, True, {"sighted": None}, "too few points since the last change"),
        (FPS, True, {"sighted": 1.049}, ""),
        (FPS, True, {"sighted": 1.051}, "points differ so much that a change above the threshold could not be seen"),
        (HOST, False, {"sighted": 4.9}, ""),
        (HOST, False, {"sighted": 5.2}, "points differ so much that a change above the threshold could not be seen"),
        (HOST, False, {"sighted": None, "shifts": "newest"}, ""),
        (HOST, False, {"sighted": None, "shifts": "earlier"}, "too few points since the last change"),
    ],
)
def test_what_the_newest_point_could_hide(metric: Any, logs: bool, more: dict[str, Any], why: str) -> None:
    """Leave a gate open where a change that matters could have happened at the newest point without being marked."""
    if where := more.get("shifts"):
        at = 12 if where == "newest" else 11
        more = {**more, "shifts": (Shift(at, at - 1, Change.SMALL, 1.0, 2.0, 2.0, None, 0.01),)}
    found = curve(metric, [90.0, 95.0, 100.0], logs=logs, **more)
    assert found.undecided(12, SETTINGS) == why
    if not why or "points" in why:
        assert found.undecided(13, SETTINGS) == "the newest point has no value"


def test_what_varies_and_what_is_tested() -> None:
    """Test a curve of several values that runs do not agree in, and draw every one of several values."""
    assert curve(FPS, [1.0, 2.0]).varies
    assert curve(FPS, [1.0, 2.0]).tested
    assert curve(FPS, [1.0, 2.0], exact=True).varies
    assert not curve(FPS, [1.0, 2.0], exact=True).tested
    assert not curve(FPS, [2.0, 2.0]).varies
    assert not curve(FPS, [2.0, 2.0]).tested
    assert not curve(FPS, [1.0, 2.0], changes_missing="too large").tested
    gone = Curve(FPS, Axis.THROUGHPUT, (Sample(1, Missing("no run")), Sample(2, 5.0, None, 2, 5.0)), False, False)
    assert [sample.point for sample in gone.known] == [2]
    assert not gone.varies


@pytest.mark.parametrize(
    ("metric", "logs", "amount", "said"),
    [
        (FPS, True, None, ""), (FPS, True, 1.034, "3.4 %"), (FPS, True, 1.994, "99 %"),
        (FPS, True, 1.996, "a factor of 2"),
        (FPS, True, 99.4, "a factor of 99"), (FPS, True, 1234.0, "a factor of 1234"), (HOST, False, 3.5, "3.50 MB"),
    ],
)  # fmt: skip
def test_what_would_be_visible_in_words(metric: Any, logs: bool, amount: float | None, said: str) -> None:
    """Tell the smallest visible change in percent, as a factor, or as an amount."""
    assert visible(curve(metric, [1.0, 2.0], logs=logs, visible=amount)) == said
