"""The tests behind gsb-compare: exchange of runs within blocks, Holm, Fisher; against other ways to compute them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import combinations, permutations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import stats

from gpusimbench import open_recording
from gpusimbench.evaluator.compare.compare import _answered, _Asked
from gpusimbench.evaluator.compare.finding import Change, Counted, Finding, Settings
from gpusimbench.evaluator.compare.numbers import Schedule, matters, neighbours, schedule
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.results.metrics import METRICS
from gpusimbench.evaluator.statistics import exchange
from gpusimbench.evaluator.statistics.exchange import (
    compare_distances,
    compare_means,
    compare_within,
    count_dealings,
    dealings,
    least_p,
)
from gpusimbench.evaluator.statistics.families import able_to_reject, fisher, holm, least_fisher

ROOT = Path(__file__).resolve().parents[2]
RECORDED = open_recording(ROOT / "recordings" / "mujoco-amd-r0.mcap").provenance
ABBA = [False, True, True, False]
MB = 10**6


def test_an_unblocked_test_is_the_one_of_scipy() -> None:
    """Agree with SciPy's exact permutation test of a difference of means."""
    rng = np.random.default_rng(5)
    values, head = rng.normal(size=10), np.array([0, 1] * 5, dtype=bool)
    ours = compare_means(values, head, np.zeros(10))
    theirs = stats.permutation_test(
        (values[head], values[~head]), lambda a, b: a.mean() - b.mean(), n_resamples=10**6, alternative="two-sided"
    )
    assert ours.n == 252
    assert ours.difference == pytest.approx(theirs.statistic)
    assert ours.p_value == pytest.approx(theirs.pvalue)


def test_blocks_give_exactly_their_own_dealings() -> None:
    """Enumerate six ways in each block of four, the observed one first, none twice."""
    head, blocks = ABBA * 2, [0] * 4 + [1] * 4
    found = dealings(head, blocks)
    assert found.exhaustive
    assert len({row.tobytes() for row in found.head}) == len(found.head) == count_dealings(head, blocks) == 36
    assert found.head[0].tolist() == head
    assert (found.head[:, :4].sum(axis=1) == 2).all()


def test_blocks_of_other_sizes_count_by_their_precision() -> None:
    """Give the difference that least squares gives where every block has a level of its own."""
    blocks = np.array([0, 0, 1, 1, 1, 2, 2, 2, 2, 2])
    head = np.array([0, 1, 0, 0, 1, 0, 1, 1, 1, 1], dtype=bool)
    values = np.random.default_rng(4).normal(size=10)
    design = np.column_stack([head, blocks[:, None] == np.unique(blocks)])
    difference = np.linalg.lstsq(design.astype(float), values, rcond=None)[0][0]
    assert compare_means(values, head, blocks).difference == pytest.approx(difference)


def test_a_known_p_value_of_pairs() -> None:
    """Find 2 of 64 for six pairs that all go the same way, and nothing smaller is possible."""
    head, blocks = [False, True] * 6, np.repeat(range(6), 2)
    values = np.where(head, 1.0, 0.0) + np.repeat([3.0, 1.0, 4.0, 1.0, 5.0, 9.0], 2)
    found = compare_means(values, head, blocks)
    assert found.p_value == found.least_p == least_p(head, blocks) == 2 / 64
    assert found.difference == pytest.approx(1.0)
    assert (found.low, found.high) == (pytest.approx(1.0), pytest.approx(1.0))  # whatever the pairs' own levels


def test_drift_cancels_within_blocks_alone() -> None:
    """See a small change through a drift a hundred times as large where neighbours are compared."""
    time = np.arange(24)
    head = np.array(ABBA * 6)
    values = 1.0 * time + 0.3 * head + 0.01 * np.random.default_rng(0).normal(size=24)
    blocked = compare_means(values, head, time // 4)
    assert blocked.difference == pytest.approx(0.3, abs=0.02)
    assert compare_means(values, head, np.zeros(24)).p_value > 0.5


@given(st.integers(0, 10**6), st.sampled_from([(3, 1), (2, 2), (1, 6), (1, 5)]))
def test_the_interval_holds_what_the_test_does_not_reject(seed: int, shape: tuple[int, int]) -> None:
    """Reject every shift just outside of the interval and none just inside."""
    count, size = shape
    rng = np.random.default_rng(seed)
    head = np.array((ABBA * 3)[: 2 * size if count == 1 else 4] * count)
    blocks = np.repeat(range(count), len(head) // count)
    values = rng.normal(size=len(head)) + head
    found = compare_means(values, head, blocks)
    if found.low is None or found.high is None:
        assert found.least_p > 0.05
        return
    step = 1e-6 * (found.high - found.low)
    for shift, inside in (
        (found.low - step, False), (found.low + step, True), (found.high - step, True), (found.high + step, False),
    ):  # fmt: skip
        assert (compare_means(values - shift * head, head, blocks).p_value > 0.05) == inside


@given(st.lists(st.integers(0, 3), min_size=8, max_size=8), st.booleans())
def test_exchanging_the_sides_mirrors_the_test(levels: list[int], blocked: bool) -> None:
    """Give the negative difference, the same p and the mirrored interval, with ties too."""
    head, blocks = np.array(ABBA * 2), np.repeat([0, 1], 4) * blocked
    one, other = compare_means(levels, head, blocks), compare_means(levels, ~head, blocks)
    assert one.difference == pytest.approx(-other.difference)
    assert one.p_value == other.p_value
    if one.low is not None and one.high is not None:
        assert other.low == pytest.approx(-one.high)
        assert other.high == pytest.approx(-one.low)


def test_equal_values_are_never_told_apart() -> None:
    """Give p = 1 where all runs have one value, however it rounds."""
    found = compare_means([0.1 + 0.2] * 8, ABBA * 2, [0] * 8)
    assert found.p_value == 1.0
    assert found.difference == 0.0


@pytest.mark.parametrize("blocks", [[0] * 12, np.repeat([0, 1, 2], 4)], ids=["free", "blocks"])
def test_p_is_uniform_where_nothing_differs(blocks: list[int]) -> None:
    """Reject as often as the level says, and no more often, among 400 sets of one law."""
    rng = np.random.default_rng(11)
    p = [compare_means(rng.normal(size=12), ABBA * 3, blocks).p_value for _ in range(400)]
    for level in (0.01, 0.05, 0.2, 0.5):
        # 400 * level cases, with four standard deviations to either side
        assert abs(np.mean(np.array(p) <= level) - level) < 4 * math.sqrt(level * (1 - level) / 400) + 0.005


def test_more_dealings_than_can_be_looked_at_are_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw with a seed, keep the observed one among them, and come close to the exact p."""
    rng = np.random.default_rng(3)
    values, head = rng.normal(size=16) + 0.5 * np.array(ABBA * 4), ABBA * 4
    exact = compare_means(values, head, [0] * 16)
    monkeypatch.setattr(exchange, "MOST_DEALINGS", 100)
    drawn = compare_means(values, head, [0] * 16)
    assert (exact.exhaustive, drawn.exhaustive, drawn.n) == (True, False, exchange.DRAWN + 1)
    assert (exact.ways, drawn.ways) == (f"all {math.comb(16, 8)} ways", "9999 ways drawn with seed 0")
    assert drawn.p_value == pytest.approx(exact.p_value, abs=0.02)
    assert drawn == compare_means(values, head, [0] * 16)


def test_very_many_runs_take_no_more_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw fewer dealings of more runs."""
    monkeypatch.setattr(exchange, "MOST_CELLS", 100_000)
    head = ABBA * 25
    assert dealings(head, [0] * 100).head.shape == (1001, 100)
    assert least_p(head, [0] * 100) == 1 / 1001


def test_distances_that_are_known() -> None:
    """Find two clusters apart with the smallest p there is, and one cluster not."""
    places = np.array([0.0, 0.1, 0.2, 5.0, 5.1, 5.2])
    matrix = abs(places[:, None] - places)
    apart = compare_distances(matrix, [False] * 3 + [True] * 3)
    assert apart.p_value == apart.least_p == 2 / 20
    assert apart.difference == pytest.approx(matrix[:3, 3:].mean() - matrix[:3, :3].sum() / 6)
    assert compare_distances(matrix, [False, True] * 3).p_value > 0.5


@pytest.mark.parametrize("spread", [1.0, 3.0, 30.0])
def test_distances_within_the_sides_by_hand(spread: float) -> None:
    """Count the ways to deal six runs that are at least as uneven, to either side, as the one that was observed."""
    places = np.random.default_rng(2).normal(size=6) * np.where(np.arange(6) < 3, 1.0, spread)
    matrix = abs(places[:, None] - places)

    def further(second: tuple[int, ...]) -> float:
        first = [run for run in range(6) if run not in second]
        one, other = (np.mean([matrix[i, j] for i, j in combinations(side, 2)]) for side in (first, second))
        return float(other - one)

    observed = further((3, 4, 5))
    ways = [abs(further(second)) >= abs(observed) - 1e-12 for second in combinations(range(6), 3)]
    found = compare_within(matrix, [False] * 3 + [True] * 3)
    assert found.difference == pytest.approx(observed)
    assert found.p_value == pytest.approx(np.mean(ways))


def test_what_cannot_be_tested_is_refused() -> None:
    """Raise for one-sided blocks, for values that are no numbers or not one a run, and for a side of one run."""
    for values, size in (([1.0], 2), ([1.0, 2.0, 3.0], 2), ([[1.0, 2.0]], 2), ([1.0, math.inf], 2)):
        with pytest.raises(ValueError, match="values must be finite, one for each run"):
            compare_means(values, [False, True][:size], [0, 0])
    for head, blocks in (([False, True], [0]), ([True], [0, 0]), ([[False, True]], [[0, 0]]), ([], [])):
        with pytest.raises(ValueError, match="head and blocks must have one entry for each run"):
            dealings(head, blocks)
    for matrix in (np.zeros((3, 4)), np.zeros((4, 3)), np.zeros((4, 4, 1)), np.full((4, 4), math.nan)):
        with pytest.raises(ValueError):
            compare_distances(matrix, [False, False, True, True])
    with pytest.raises(ValueError, match="one side alone"):
        compare_means([1.0, 2.0], [False, False], [0, 0])
    with pytest.raises(ValueError, match="finite"):
        compare_means([1.0, math.nan], [False, True], [0, 0])
    with pytest.raises(ValueError, match="two runs a side"):
        compare_distances(np.zeros((3, 3)), [False, True, True])


@given(st.lists(st.floats(0, 1), min_size=1, max_size=6))
def test_holm_is_what_its_definition_says(p_values: list[float]) -> None:
    """Reject by adjusted values exactly what the step-down procedure rejects, in whatever order they come."""
    adjusted = holm(p_values)
    assert all(a >= p for a, p in zip(adjusted, p_values, strict=True))
    for alpha in (0.01, 0.05, 0.3):
        rejected = 0
        for rank, p in enumerate(sorted(p_values)):
            if (len(p_values) - rank) * p > alpha:
                break
            rejected += 1
        assert sum(a <= alpha for a in adjusted) == rejected
    for order in list(permutations(range(len(p_values))))[:6]:
        assert holm([p_values[i] for i in order]) == [adjusted[i] for i in order]


def test_holm_of_nothing() -> None:
    """Adjust no test to no test."""
    assert holm([]) == []


@given(st.integers(1, 8), st.integers(1, 8), st.data())
def test_fisher_is_the_one_of_scipy(n1: int, n2: int, data: st.DataObject) -> None:
    """Agree with SciPy on every table."""
    a, b = data.draw(st.integers(0, n1)), data.draw(st.integers(0, n2))
    expected = stats.fisher_exact([[a, n1 - a], [b, n2 - b]]).pvalue
    assert fisher((a, n1), (b, n2)) == pytest.approx(expected)
    assert fisher((a, n1), (b, n2)) == fisher((b, n2), (a, n1))


def test_fisher_refuses_what_is_no_count() -> None:
    """Raise for more failures than runs, and for a side without runs."""
    for first, second in (((2, 1), (0, 1)), ((0, 0), (0, 1))):
        with pytest.raises(ValueError, match="not counts"):
            fisher(first, second)


@given(st.integers(1, 6), st.integers(1, 6), st.data())
def test_no_table_is_below_the_least_p(n1: int, n2: int, data: st.DataObject) -> None:
    """Find the smallest p of all tables with these margins."""
    odd = data.draw(st.integers(0, n1 + n2))
    tables = [((k, n1), (odd - k, n2)) for k in range(max(0, odd - n2), min(odd, n1) + 1)]
    assert least_fisher(odd, n1, n2) == min(fisher(*table) for table in tables)


@given(st.lists(st.sampled_from([0.5, 0.1, 0.04, 0.03, 0.01, 0.002, 0.0001]), max_size=30))
@example([0.03, *[0.01] * 6])  # six that no family of six can reject, and a seventh that is not rejected beside them
@example([0.03, 0.04, 0.04])
def test_a_family_has_only_tests_that_can_be_rejected(least: list[float]) -> None:
    """Keep tests that reach the level of their family, the best ones, and as many as any level is reached by so few."""
    able = able_to_reject(least, 0.05)
    family, out = ([p for p, can in zip(least, able, strict=True) if can is kept] for kept in (True, False))
    assert all(p <= 0.05 / len(family) for p in family)
    assert max(family, default=0.0) < min(out, default=1.0)
    reached = [sum(p <= 0.05 / size for p in least) for size in range(1, len(least) + 1)]
    assert len(family) == max((n for size, n in enumerate(reached, start=1) if n <= size), default=0)


@dataclass(frozen=True)
class Asked:
    """A question whose p is known."""

    p: float

    @property
    def least_p(self) -> float:
        """It can give no other."""
        return self.p

    def __call__(self, level: float, *, able: bool) -> tuple[Finding, Finding]:
        """Two findings, which have the level in their notes."""
        shown = Finding(Axis.BITS, "q", "q", Change.CHANGED, p_value=self.p, note=f"{level:.3g}, {able}")
        return shown, replace(shown, change=Change.UNCLEAR)


def test_axes_that_do_not_count_make_no_other_p_larger() -> None:
    """Adjust for the tests of axes with a gate that could show something; variability and other axes by themselves."""
    settings = Settings(gates=frozenset({Axis.THROUGHPUT, Axis.MEMORY}))
    axes = [Axis.THROUGHPUT, Axis.MEMORY, Axis.MEMORY, Axis.BUILD, Axis.DETERMINISM, Axis.VARIABILITY]
    drafts = [[_Asked(axis, Asked(p)) for axis, p in zip(axes, (0.02, 0.01, 0.5, 0.02, 0.01, 0.04), strict=True)]]
    (found,), tests = _answered(drafts, settings)
    assert tests == 2
    assert [one.p_adjusted for one in found] == [0.02, 0.02, None, 0.02, 0.02, 0.04]
    assert [one.change is Change.CHANGED for one in found] == [True, True, False, True, True, True]
    assert [one.note for one in found] == [
        "0.025, True", "0.025, True", "0.025, False", "0.025, True", "0.025, True", "0.05, True",
    ]  # fmt: skip
    assert _answered(drafts[:0], settings) == ([], 0)
    assert _answered([drafts[0][3:]], settings)[1] == 0


def test_few_runs_of_one_configuration_do_not_hide_another() -> None:
    """Leave out a hundred tests that nothing could reject, beside one that could be."""
    assert able_to_reject([0.5] * 100 + [0.01], 0.05) == [False] * 100 + [True]
    assert able_to_reject([], 0.05) == []


@pytest.mark.parametrize(
    ("order", "blocks"),
    [
        ("ABBAABBA", "00112233"), ("ABAB", "0011"), ("AAABBB", "000000"), ("AB", "00"), ("ABA", "000"),
        ("AABBAABB", "00011222"), ("AAAA", "0000"),
    ],
)  # fmt: skip
def test_neighbours_in_time(order: str, blocks: str) -> None:
    """Cut an order into the shortest stretches that hold both sides."""
    assert "".join(map(str, neighbours([letter == "B" for letter in order]))) == blocks


@pytest.mark.parametrize(
    ("n", "blocks", "interleaved"),
    [
        ((2, 2), 1, False), ((2, 2), 2, True), ((3, 9), 2, True), ((4, 4), 2, True), ((5, 5), 2, False),
        ((5, 5), 3, True), ((6, 6), 2, False), ((6, 6), 4, True), ((7, 7), 3, False), ((9, 7), 4, True),
    ],
)  # fmt: skip
def test_blocks_that_are_short_enough(n: tuple[int, int], blocks: int, interleaved: bool) -> None:
    """Take runs for interleaved from two blocks on, of four runs on average; never where their times are not known."""
    head = (False,) * n[0] + (True,) * n[1]
    numbers = tuple(sorted(i % blocks for i in range(len(head))))
    assert Schedule((), head, numbers, known=True).interleaved is interleaved
    assert not Schedule((), head, numbers, known=False).interleaved


@pytest.mark.parametrize(
    ("seconds", "known"),
    [((0, 0), False), ((0, 1), True), ((0, 0, 1, 1), True), ((0, 0, 0, 1, 1), False), ((0, 1, 2, 2, 2, 2, 2), False)],
)
def test_times_that_tell_the_order(seconds: tuple[int, ...], known: bool) -> None:
    """Take the order for known where there is a second for two runs, and more than one; never where a time is none."""

    def made(times: list[str]) -> Schedule:
        runs: Any = [SimpleNamespace(provenance=replace(RECORDED, created_utc=t, run_id=str(i)))
                     for i, t in enumerate(times)]  # fmt: skip
        return schedule(runs[::2], runs[1::2])

    times = [f"2026-01-01T00:00:0{second}Z" for second in seconds]
    assert made(times).known is known
    assert not made([*times[:-1], "yesterday"]).known


@given(st.integers(1, 40), st.integers(1, 40), st.data())
def test_only_uneven_counts_leave_a_question_open(n_base: int, n_head: int, data: st.DataObject) -> None:
    """Leave nothing open where as large a share of either side's runs does something, however few the runs are."""
    base = data.draw(st.integers(0, n_base)), n_base
    head = data.draw(st.integers(0, n_head) | st.just(base[0] * n_head // n_base)), n_head
    asked = Counted(Finding(Axis.PHYSICS, "sank", "sank", Change.REGRESSION), base, head, "that sank")
    for able in (True, False):
        _, otherwise = asked(0.05, able=able)
        even = Fraction(*base) == Fraction(*head)
        assert otherwise.left_open == (() if able or even else (Change.REGRESSION,))


def test_drawn_dealings_of_distances(monkeypatch: pytest.MonkeyPatch) -> None:
    """Count the observed dealing among those that are drawn, and give the smallest p that so many can have."""
    places = np.concatenate([np.linspace(0, 1, 8), np.linspace(9, 10, 8)])
    matrix = abs(places[:, None] - places)
    monkeypatch.setattr(exchange, "MOST_DEALINGS", 100)
    found = compare_distances(matrix, [False] * 8 + [True] * 8)
    assert (found.exhaustive, found.n) == (False, exchange.DRAWN + 1)
    assert found.least_p == 1 / found.n
    assert found.p_value < 0.01


def test_sides_of_different_size_have_no_mirror() -> None:
    """Give one dealing of all as the smallest p where the sides differ in size, and both differences by hand."""
    places = np.array([0.0, 0.1, 5.0, 5.3, 5.7])
    matrix = abs(places[:, None] - places)
    found = compare_distances(matrix, [False, False, True, True, True])
    within2 = (0.3 + 0.7 + 0.4) / 3
    assert found.difference == pytest.approx(matrix[:2, 2:].mean() - (0.1 + within2) / 2)
    assert found.p_value == found.least_p == 1 / 10
    assert least_p([False, False, True, True, True], [0] * 5) == 1 / 10


@pytest.mark.parametrize(
    ("name", "one", "other", "counts"),
    [
        ("fps", 1.0, 1.06, True),
        ("fps", 1.0, 1.04, False),
        ("fps", 0.0, 1e-9, True),
        ("fps", 0.0, 0.0, False),
        ("host_memory_peak_increment", MB, 1.99 * MB, False),
        ("host_memory_peak_increment", MB, 2 * MB, True),
        ("host_memory_peak_increment", 1000 * MB, 1040 * MB, False),
        ("host_memory_peak_increment", 1000 * MB, 1060 * MB, True),
        ("compile_time", 2e-6, 1.001e-3, False),
        ("compile_time", 2e-6, 1.003e-3, True),
        ("build_time", 1.0, 1.04, False),
        ("build_time", 1.0, 1.06, True),
        ("w1_run_to_run", 0.001, 0.0109, False),
        ("w1_run_to_run", 0.001, 0.0111, True),
        ("w1_run_to_run", 1.0, 1.04, False),
    ],
)
def test_what_matters(name: str, one: float, other: float, counts: bool) -> None:
    """Count a change above the threshold; at least 1 MB, 1 ms or 0.01 cm; up and down alike."""
    assert matters(METRICS[name], one, other, Settings()) is counts
    assert matters(METRICS[name], other, one, Settings()) is counts


@pytest.mark.parametrize(("threshold", "least"), [(0.05, 1.05), (0.5, 1.5), (0.0, 1.0)])
def test_a_threshold_is_a_factor(threshold: float, least: float) -> None:
    """Count no change by the very threshold, and every larger one."""
    settings = Settings(threshold=threshold)
    assert not settings.matters(1000.0, 1000.0 * least)
    assert settings.matters(1000.0, 1000.0 * least * (1 + 1e-9))
    assert settings.matters(1000.0 * least * (1 + 1e-9), 1000.0)
