"""Change points of series: what is marked, how often for nothing, and what stays what it is."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from gpusimbench.evaluator.missing import known, why_missing
from gpusimbench.evaluator.statistics.change_points import change_points, least_visible, steps_of

LEVEL = 0.05
series = st.lists(st.floats(-10, 10).map(lambda v: round(v, 3)), min_size=0, max_size=24)


def noisy(points: int, seed: int = 0) -> NDArray[np.float64]:
    """Independent normal values."""
    return np.random.default_rng(seed).normal(size=points)


@pytest.mark.parametrize("at", [1, 4, 11])
def test_one_change_is_marked_where_it_is(at: int) -> None:
    """Mark a change far above the noise at its first point, also where that is the second or the newest."""
    values = noisy(12) + 40.0 * (np.arange(12) >= at)
    (found,) = change_points(values, 0.001)
    assert (found.index, found.begin, found.end) == (at, 0, 12)
    assert found.before == pytest.approx(values[:at].mean())
    assert found.difference == pytest.approx(values[at:].mean() - values[:at].mean())


def test_a_change_that_is_undone_is_two_changes() -> None:
    """Mark both ends of an inner part, whose splits alone would hide each other."""
    values = noisy(15) + 12.0 * ((np.arange(15) >= 6) & (np.arange(15) < 9))
    assert [one.index for one in change_points(values, LEVEL)] == [6, 9]


def test_several_changes() -> None:
    """Search the parts on both sides of a change again."""
    values = noisy(40) + 20.0 * (np.arange(40) >= 10) + 20.0 * (np.arange(40) >= 30)
    assert [one.index for one in change_points(values, LEVEL)] == [10, 30]


def test_p_and_interval_of_a_split_are_those_of_the_t_test() -> None:
    """Agree with SciPy's two-sample t-test, times the splits that were looked at and the two kinds of candidates."""
    values = noisy(9, seed=5) + 9.0 * (np.arange(9) >= 4)
    (found,) = change_points(values, LEVEL)
    test = stats.ttest_ind(values[4:], values[:4])
    assert found.p_value == pytest.approx(8 * 2 * test.pvalue)
    assert found.ci95 == pytest.approx(tuple(test.confidence_interval(0.95)))


@pytest.mark.parametrize("points", [3, 6, 20])
def test_false_alarms_stay_below_the_level(points: int) -> None:
    """Mark nothing in at least 1 - level of series without a change: the bound holds at every length."""
    count = 600
    alarms = sum(bool(change_points(noisy(points, seed), LEVEL)) for seed in range(count))
    assert stats.binomtest(alarms, count, LEVEL, alternative="greater").pvalue > 0.001


def test_what_would_be_visible_is_visible() -> None:
    """Give a distance at which one more point is marked, and that half of it is not."""
    values = noisy(10)
    least = least_visible(values, LEVEL)
    assert least is not None
    for share, marked in ((1.001, [10]), (0.5, [])):
        longer = np.append(values, values.mean() + share * least)
        assert [one.index for one in change_points(longer, LEVEL)] == marked


@pytest.mark.parametrize("since", [1, 2, 3])
def test_a_change_soon_after_another_is_seen(since: int) -> None:
    """Hold the few points behind a change to the noise of those before it."""
    values = noisy(10 + since) + 30.0 * (np.arange(10 + since) >= 10)
    assert [one.index for one in change_points(values, LEVEL)] == [10]
    least = least_visible(values[10:], LEVEL, [values[:10]])
    assert least is not None
    for share, marked in ((1.1, [10, 10 + since]), (0.5, [10])):
        longer = np.append(values, values[10:].mean() + share * least)
        assert [one.index for one in change_points(longer, LEVEL)] == marked
    assert least_visible(values[10:11], LEVEL) is None


def test_false_alarms_beside_a_change_stay_rare() -> None:
    """Mark another point beside a large change in about as many series as have a false alarm without one."""
    count, at = 600, 8
    alarms = 0
    for seed in range(count):
        found = change_points(noisy(12, seed) + 30.0 * (np.arange(12) >= at), LEVEL)
        alarms += {one.index for one in found} != {at}
    # both stretches may raise an alarm
    assert stats.binomtest(alarms, count, 2 * LEVEL, alternative="greater").pvalue > 0.001


def test_noise_too_small_for_squares_is_no_change() -> None:
    """Mark nothing in differences whose squares vanish beside a change."""
    assert [one.index for one in change_points([0.0, 1e-200, 0.0, 1e-200, 1.0, 1.0, 1.0], LEVEL)] == [4]


@given(series, st.floats(-5, 5), st.sampled_from([0.01, 3.0, 1000.0]))
def test_neither_shift_nor_scale_moves_a_change_point(values: list[float], shift: float, scale: float) -> None:
    """Mark the same points of a series in another unit."""
    found = change_points(values, LEVEL)
    moved = change_points([scale * (v + shift) for v in values], LEVEL)
    chances = [known(one.p_value) or 0.0 for one in (*found, *moved)]
    if all(p > 1e-6 and abs(p - LEVEL) > 1e-3 for p in chances):
        assert [one.index for one in moved] == [one.index for one in found]


@given(series)
def test_parts_are_what_changes_say(values: list[float]) -> None:
    """Cover the series without a gap, each level the mean of its points, no level next to an equal one."""
    found = change_points(values, LEVEL)
    for one in found:
        assert 0 <= one.begin < one.index < one.end <= len(values)
        assert one.before == pytest.approx(np.mean(values[one.begin : one.index]), abs=1e-9)
        assert one.after == pytest.approx(np.mean(values[one.index : one.end]), abs=1e-9)
        assert 0 <= (known(one.p_value) or 0.0) <= LEVEL
        assert one.ci95 is None or one.ci95[0] <= one.difference <= one.ci95[1]
    assert all((left.index, left.end) == (right.begin, right.index) for left, right in pairwise(found))


@given(st.floats(-1e300, 1e300), st.integers(0, 30))
def test_equal_values_have_no_change(value: float, count: int) -> None:
    """Mark nothing in a constant series, however large its value: its sums round."""
    assert change_points([value] * count, LEVEL) == []


@pytest.mark.parametrize(
    "values", [[5.0] * 4 + [6.0] * 4, [5.0, 6.0, 6.0], [0.1] * 5 + [0.3], [5.0] * 4 + [6.0] * 3 + [5.0]]
)
def test_values_without_noise_have_no_p(values: list[float]) -> None:
    """Mark where the value changes, and say why there is neither a p-value nor an interval, however few the points."""
    found = change_points(values, LEVEL)
    assert [one.index for one in found] == steps_of(values)
    assert all("each level are equal" in why_missing(one.p_value) and one.ci95 is None for one in found)


def test_noise_far_below_a_change_has_a_p() -> None:
    """Give p and interval where levels differ a million times as much as their points do."""
    (found,) = change_points([5.0, 5.000001, 5.0, 6.0, 6.000001, 6.0], LEVEL)
    assert found.ci95[0] < 1.0 < found.ci95[1]
    assert 0 < known(found.p_value) < 1e-12


@pytest.mark.parametrize(
    ("values", "level", "why"),
    [([1.0, math.nan], 0.05, "finite"), ([[1.0]], 0.05, "shape"), ([1.0], 0.0, "probability"), ([1.0], 1.5, "prob")],
)
def test_what_is_refused(values: list[float], level: float, why: str) -> None:
    """Refuse values that are no numbers, and levels that are no probabilities."""
    with pytest.raises(ValueError, match=why):
        change_points(values, level)
