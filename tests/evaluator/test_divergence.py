"""Bits that differ, how far apart they are, and how that grows."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.json_values import values_of
from gpusimbench.evaluator.metrics.divergence import (
    GrowthFit,
    by_first_appearance,
    differs,
    first_reaching,
    first_true,
    fit_growth,
    resolution,
    ulp_distance,
    why_no_rate,
)
from gpusimbench.evaluator.missing import Missing

WORDS = {"<f2": 16, "<f4": 32, "<f8": 64}
PATTERNS = st.sampled_from(list(WORDS)).flatmap(
    lambda dtype: st.tuples(st.just(dtype), *[st.integers(0, 2 ** WORDS[dtype] - 1)] * 3)
)


def number(dtype: str, bits: int) -> Any:
    """The number of a bit pattern, shape [1]."""
    return np.array([bits], dtype=dtype.replace("f", "u")).view(dtype)


def ulp(a: Any, b: Any) -> int:
    """Distance of two numbers."""
    return int(ulp_distance(a, b)[0])


@given(PATTERNS)
def test_ulps_are_a_metric_on_bits(patterns: tuple[str, int, int, int]) -> None:
    """Be zero for equal bits alone, symmetric, and no longer by a detour; NaN, infinities and zeros included."""
    dtype, *bits = patterns
    a, b, c = (number(dtype, word) for word in bits)
    assert (ulp(a, b) == 0) == (bits[0] == bits[1]) == (not differs(a, b)[0])
    assert ulp(a, b) == ulp(b, a)
    assert ulp(a, c) <= ulp(a, b) + ulp(b, c)


@given(st.floats(-(2.0**126), 2.0**126, width=32), st.integers(0, 1000))
def test_ulps_count_steps_of_nextafter(start: float, steps: int) -> None:
    """Count as many as steps were taken to the next number, except that zero is there twice."""
    at = np.float32(start)
    for _ in range(steps):
        at = np.nextafter(at, np.float32(np.inf))
    crossed = int(math.copysign(1, start) < 0 and math.copysign(1, at) > 0)
    assert ulp(np.array([np.float32(start)]), np.array([at])) == steps + crossed


def test_ulps_at_the_edges() -> None:
    """Hold the definition: one between the zeros, one from the largest number to infinity, payloads by number."""
    zero, minus = np.array([0.0]), np.array([-0.0])
    assert ulp(zero, minus) == 1
    assert ulp(np.array([np.finfo(np.float64).max]), np.array([np.inf])) == 1
    quiet = number("<f4", 0x7FC00000)
    assert ulp(quiet, number("<f4", 0x7FC00003)) == 3
    assert ulp(number("<f8", 2**64 - 1), number("<f8", 2**63 - 1)) == 2**64 - 1
    with pytest.raises(ValueError, match="one dtype"):
        ulp_distance(np.zeros(1, np.float32), np.zeros(1))
    with pytest.raises(ValueError, match="floating-point"):
        ulp_distance(np.zeros(1, np.int32), np.zeros(1, np.int32))
    with pytest.raises(ValueError, match="real, of 1, 2, 4 or 8 bytes, not complex64"):
        differs(np.zeros(1, np.complex64), np.zeros(1, np.complex64))


@pytest.mark.parametrize("dtype", ["bool", "int8", "uint16", "int32", "int64"])
def test_numbers_that_are_not_floating_point_have_bits_too(dtype: str) -> None:
    """Tell whole numbers and truth values apart by their bits."""
    a, b = np.array([0, 1, 1, 0]).astype(dtype), np.array([0, 1, 0, 1]).astype(dtype)
    assert differs(a, b).tolist() == [False, False, True, True]


@given(st.floats(-1e3, 1e3), st.floats(-1e5, 1e5), st.floats(-1e5, 1e5))
def test_storing_at_two_origins_stays_within_the_resolution(place: float, first: float, second: float) -> None:
    """Never see a difference in one place that is only stored in float32 beside two origins."""
    a, b = np.array([np.float32(place + first)]), np.array([np.float32(place + second)])
    apart = abs((float(a[0]) - first) - (float(b[0]) - second))
    rounding = 4 * np.spacing(abs(place) + abs(first) + abs(second))  # of this sum in float64
    assert apart <= resolution(a, b)[0] + rounding


@given(st.lists(st.integers(0, 3), max_size=12), st.randoms())
def test_classes_do_not_depend_on_order(keys: list[int], random: Any) -> None:
    """Put the same members together in any order, numbered as they appear."""
    labels = by_first_appearance(np.array(keys, dtype=np.uint64))
    assert [keys[i] == keys[j] for i in range(len(keys)) for j in range(i)] == [
        labels[i] == labels[j] for i in range(len(keys)) for j in range(i)
    ]
    assert list(dict.fromkeys(labels.tolist())) == list(range(len(set(keys))))
    order = list(range(len(keys)))
    random.shuffle(order)
    moved = by_first_appearance(np.array([keys[i] for i in order], dtype=np.uint64))
    sets = {frozenset(np.flatnonzero(labels == c).tolist()) for c in set(labels.tolist())}
    assert {frozenset(order[i] for i in np.flatnonzero(moved == c)) for c in set(moved.tolist())} == sets


def test_first_true_is_the_first_in_order() -> None:
    """Return the first index in C order, None of nothing and of an empty mask."""
    mask = np.zeros((3, 4, 2), dtype=bool)
    assert first_true(mask) is None
    mask[1, 2, 1] = mask[2, 0, 0] = mask[1, 3, 0] = True
    assert first_true(mask) == (1, 2, 1)
    assert first_true(np.zeros((0, 2), dtype=bool)) is None


@given(st.floats(0.1, 50), st.floats(1e-9, 1e-6))
def test_the_rate_of_an_exponential_is_found(rate: float, start: float) -> None:
    """Return the rate that the distances were made with, from the window below the limit alone."""
    times = np.arange(1, 4001) * 1e-3
    distances = np.minimum(start * np.exp(np.minimum(rate * times, 300)), 0.5)  # saturates far above the limit
    fit = fit_growth(times, distances, limit=1e-3)
    assert fit.rate == pytest.approx(rate, rel=1e-6)
    assert fit.r_squared == pytest.approx(1)
    assert fit.begin_s == times[0]
    assert start * math.exp(rate * fit.end_s) < 1e-3
    assert fit.doubling_time == pytest.approx(math.log(2) / rate)


def test_no_rate_without_enough_points() -> None:
    """Say why there is none: nothing apart, too few steps, a gap that is not finite, no growth at all."""
    times = np.arange(10.0)
    assert fit_growth(times, np.zeros(10), limit=1e-3) == Missing("nothing moved apart")
    jump = np.array([0, 0, 1e-6, 1e-5, 0, 0, 1e-4, 1e-4, 1.0, 1.0])
    assert "4 recorded steps" in str(fit_growth(times, jump, limit=1e-3))
    broken = np.array([1e-9, 1e-8, np.nan, *[1e-6] * 7])
    assert "2 recorded steps" in str(fit_growth(times, broken, limit=1e-3))
    assert "does not grow" in str(fit_growth(times, np.full(10, 1e-6), limit=1e-3))
    shrinking = fit_growth(times, 1e-6 * np.exp(-times), limit=1e-3)
    assert (shrinking.rate, shrinking.doubling_time) == (pytest.approx(-1), None)


def test_the_time_at_which_a_size_is_reached() -> None:
    """Return the first time at which it is reached, None where it never is; what is not finite is no size."""
    times, distances = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.0, np.nan, 0.01, 0.001])
    assert first_reaching(times, distances, 0.001) == 2.0
    assert first_reaching(times, distances, 0.02) is None


def test_bits_are_not_values() -> None:
    """Tell apart what compares equal, and not what compares unequal to itself."""
    nan = np.array([struct.unpack("<d", struct.pack("<Q", 0x7FF8000000000001))[0]])
    assert differs(np.array([0.0]), np.array([-0.0]))[0]
    assert not differs(nan, nan.copy())[0]
    assert differs(nan, np.array([np.nan]))[0]


def test_the_fit_says_how_much_it_explains() -> None:
    """Give the squared correlation of time and log(distance), which least squares through noise has."""
    times = np.linspace(0.1, 2.0, 40)
    logs = 3.0 * times - 15.0 + np.random.default_rng(0).normal(scale=2.0, size=40)
    fit = fit_growth(times, np.exp(logs), limit=1.0)
    assert fit.n_point == 40
    assert (fit.begin_s, fit.end_s) == (times[0], times[-1])
    correlation = np.corrcoef(times, logs)[0, 1]
    assert 0.1 < correlation**2 < 0.9
    assert fit.r_squared == pytest.approx(correlation**2)
    assert fit.rate == pytest.approx(np.polyfit(times, logs, 1)[0])


def test_five_points_make_a_rate() -> None:
    """Fit exactly as many points as a rate needs, and stop at a distance that equals the limit."""
    times, distances = np.arange(7.0), 2.0 ** np.arange(-40, -33)
    fit = fit_growth(times, distances, limit=float(distances[5]))
    assert (fit.n_point, fit.begin_s, fit.end_s) == (5, 0.0, 4.0)
    assert fit.doubling_time == pytest.approx(1.0)
    none = fit_growth(times, distances, limit=float(distances[4]))
    assert none.reason.startswith("4 recorded steps with a distance above zero before it passes ")


def test_no_rate_of_what_does_not_grow_exponentially() -> None:
    """Refuse the slope of a poor fit as a rate, and never round its R2 up to the limit."""
    assert why_no_rate(0.7999, 0.5) == "no rate: R2 0.79 of the exponential is below 0.8"
    assert not why_no_rate(0.8, 0.5)


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0, 3.0])
def test_a_power_of_time_has_no_doubling_time(power: float) -> None:
    """Refuse the slope through a drift, whose R2 as an exponential is 0.80 whatever the power; keep that of growth."""
    times = np.arange(101) * 0.01
    fit = fit_growth(times, 1e-6 * times**power, limit=1e-3)
    assert fit.r_squared > 0.8 and fit.power_r_squared == pytest.approx(1.0)
    assert values_of(fit)["why_no_rate"].startswith("no rate: the distance grows as a power of time (R2 1.000)")
    noise = np.random.default_rng(0).normal(scale=0.3, size=101)
    for begin in (0, 3):
        grown = np.where(times >= times[begin], 1e-8 * np.exp(7 * times + noise), 0.0)
        found = fit_growth(times, grown, limit=1e-3)
        assert isinstance(found, GrowthFit) and not found.why_no_rate
