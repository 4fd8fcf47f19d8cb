"""Throughput that goes with the outcome of a run: the recordings that show it, and how often chance does."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from gpusimbench.evaluator.cli.eval import main as evaluate
from gpusimbench.evaluator.json_values import values_of
from gpusimbench.evaluator.render.document import Facts
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.brief import brief
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.report.json import to_json
from gpusimbench.evaluator.report.leaders import fastest
from gpusimbench.evaluator.report.sections.overview import overview
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.details import DistinctRuns, Throughput
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.results.timed_work import speeds_of
from gpusimbench.evaluator.statistics.permutation import ALPHA, p_value, ranges_of
from tests.pages import text_of

H100 = Path(__file__).resolve().parents[2] / "recordings" / "h100"
RANGES = "3 runs at 776 to 789, 5 runs at 1,231 to 1,258, 2 runs at 1,810 to 1,825"
SIZES = [(5, 5), (3, 5, 2), (2, 3, 1, 1, 1), (1, 9)]


def labels_of(sizes: tuple[int, ...]) -> list[int]:
    """The outcome of each run, for so many runs of each outcome."""
    return np.repeat(np.arange(len(sizes)), sizes).tolist()


@pytest.fixture(scope="module")
def found() -> Evaluation:
    """Ten runs of MJX with three outcomes, and five of PhysX that are the same."""
    names = ("mjx-jax-inclined", "physx-inclined")
    return evaluate_files([path for name in names for path in sorted(H100.glob(f"{name}-collision-n16-r*.mcap"))])


def test_recordings_of_mjx_have_a_speed_for_each_outcome(found: Evaluation) -> None:
    """The ranges are those of the runs in each class by bits, no other group has any, and every output says so."""
    by_name = {result.group.key.simulator: result for result in found.results}
    fps = {name: result.metrics["fps"].of(Throughput) for name, result in by_name.items()}
    assert fps["physx"].speeds is None
    speeds, runs = fps["mjx"].speeds, by_name["mjx"].metrics["distinct_runs"].of(DistinctRuns)
    assert speeds is not None and speeds.p_value <= ALPHA and speeds.ranges == RANGES
    for label in set(runs.classes):
        ours = [value for value, own in zip(fps["mjx"].per_run or (), runs.classes, strict=True) if own == label]
        assert (len(ours), min(ours), max(ours)) in [(one.n_run, one.low, one.high) for one in speeds.outcomes]
    said = f"{RANGES} env-steps/s; the mean describes none of them"
    shown = " ".join(text_of(found).split())
    assert f"by outcome: {RANGES}" in shown and said in shown
    page = text_in(render_html(found, published=False, command="c"))
    assert page.count(f"by outcome: {RANGES}") == 1 and said in page
    (group,) = [one for one in values_of(to_json(found))["groups"] if "speeds" in one["metrics"]["fps"]["extra"]]
    assert [one["n_run"] for one in group["metrics"]["fps"]["extra"]["speeds"]["outcomes"]] == [3, 5, 2]
    assert said in " ".join(group["notes"])


def test_the_slowest_outcome_is_ranked(found: Evaluation) -> None:
    """Rank and show its range, and no mean that describes no run: between the outcomes, a simulator is second."""
    (alone,) = fastest(found.results)
    assert alone.first is not None and alone.first.fps == pytest.approx(776.2, abs=0.5)
    (on_radar,) = [one.figures.fps for one in found.comparison.contenders if one.figures.fps]
    assert on_radar == alone.first.fps
    said = "776 to 789 env-steps/s in the slowest of 3 outcomes"
    shown = io.StringIO()
    print_document(brief(found), shown)
    assert f": mjx, {said}" in " ".join(shown.getvalue().split())
    page = text_in(render_html(found, published=False, command="c"))
    assert f"mjx, {said} on NVIDIA H100" in page and "mjx: 776 to 789 16 envs the slowest of 3 outcomes" in page
    (mjx,) = (result for result in found.results if result.group.key.simulator == "mjx")
    key = replace(mjx.group.key, simulator="steady")
    fps = replace(mjx.metrics["fps"], value=1000.0, details=Throughput())
    steady = replace(mjx, group=replace(mjx.group, key=key), label="steady", metrics={**mjx.metrics, "fps": fps})
    (pair,) = fastest([mjx, steady])
    assert pair.first is not None and pair.second is not None
    assert (pair.first.result.label, pair.second.result.label) == ("steady", "mjx")


def test_one_simulator_alone_is_ranked_alike(found: Evaluation) -> None:
    """Show of a simulator that nobody is beside the group whose slowest outcome is fastest, as ranks elsewhere do."""
    (mjx,) = (result for result in found.results if result.group.key.simulator == "mjx")
    alone = replace(found, results=(mjx,))
    shown = [
        cell for block in overview(Source(alone, False, "")) if isinstance(block, Facts) for _, cell in block.pairs
    ]
    assert [cell.text for cell in shown] == ["776 to 789"]
    assert shown[0].notes[-1] == "the slowest of 3 outcomes"
    fps = replace(mjx.metrics["fps"], value=1000.0, details=Throughput())
    steady = replace(mjx, label="steady", metrics={**mjx.metrics, "fps": fps})  # slower than the mean of the other
    for results in ((mjx, steady), (steady, mjx)):
        both = overview(Source(replace(alone, results=results), False, ""))
        (said,) = [cell for block in both if isinstance(block, Facts) for _, cell in block.pairs]
        assert said.notes == ("steady, 16 envs",)


def text_in(page: str) -> str:
    """A page without its tags, in one line."""
    return " ".join(re.sub(r"<[^>]*>", " ", page).split())


def test_the_first_page_says_it(found: Evaluation, capsys: pytest.CaptureFixture[str]) -> None:
    """Of one group, and of several."""
    assert evaluate([*map(str, sorted(H100.glob("mjx-jax-inclined-*")))]) == 0
    several = io.StringIO()
    print_document(brief(found), several)
    for shown in (capsys.readouterr().out, several.getvalue()):
        assert " ".join(shown.split()).count(f"{RANGES} env-steps/s; the mean describes none of them") == 1


@pytest.mark.parametrize("sizes", SIZES, ids=str)
@pytest.mark.parametrize("law", ["normal", "heavy tails", "skewed", "few values"])
def test_chance_alone_is_found_in_at_most_one_percent(sizes: tuple[int, ...], law: str) -> None:
    """Alarms among groups whose throughputs do not go with outcomes are no more than a rate of ALPHA allows."""
    rng, groups, n_run = np.random.default_rng(1), 200, sum(sizes)
    shape = (groups, n_run)
    drawn = {
        "normal": lambda: rng.normal(1000, 20, shape),
        "heavy tails": lambda: 1000 + rng.standard_t(2, shape),
        "skewed": lambda: 1000 - rng.exponential(50, shape),
        "few values": lambda: 1000.0 + rng.integers(0, 3, shape),
    }[law]()
    alarms = sum(p_value(values, labels_of(sizes)) <= ALPHA for values in drawn)
    assert alarms <= binom.ppf(1 - 1e-4, groups, ALPHA)


def test_p_is_that_of_all_arrangements() -> None:
    """Close to the share of all orders of the runs, counted one by one."""
    values, labels = [5.0, 6.0, 5.5, 7.2, 9.0, 8.5, 7.0], np.array(labels_of((4, 2, 1)))

    def within(order: tuple[float, ...]) -> float:
        own = np.array(order)
        return float(sum(((own[labels == k] - own[labels == k].mean()) ** 2).sum() for k in range(3)))

    least = within(tuple(values))
    exact = float(np.mean([within(order) <= least + 1e-9 for order in permutations(values)]))
    assert p_value(values, labels) == pytest.approx(exact, abs=5 * np.sqrt(exact / 9999))


@pytest.mark.parametrize("sizes", SIZES[:3], ids=str)
def test_speeds_apart_are_found(sizes: tuple[int, ...]) -> None:
    """Where each outcome has its own speed, with some noise within or without any."""
    labels = labels_of(sizes)
    for noise in (0.0, 1.0):
        values = 1000 + 10 * np.array(labels) + noise * np.random.default_rng(2).random(len(labels))
        assert p_value(values, labels) <= ALPHA
        assert [one[0] for one in ranges_of(values, labels)] == list(sizes)


@pytest.mark.parametrize(
    ("values", "sizes"),
    [([1.0, 1, 1, 2, 2, 2], (3, 3)), ([1.0] * 10, (5, 5)), ([1.0, 2, 3, 4, 5, 6, 7, 8], (1,) * 8), ([1.0] * 8, (8,))],
)
def test_what_cannot_be_shown_is_not_tested(values: list[float], sizes: tuple[int, ...]) -> None:
    """Six runs, equal speeds, runs that all differ, and one outcome."""
    assert p_value(values, labels_of(sizes)) == 1.0
    assert speeds_of(values, labels_of(sizes)) is None


def test_a_sentence_says_what_the_mean_is() -> None:
    """Not that it describes no run where it lies in a range; outcomes beyond six are counted."""
    speeds = speeds_of([10.0, 10, 10, 20, 20, 20, 20, 15], labels_of((3, 4, 1)))
    assert speeds is not None and "3 runs at 10, 1 run at 15, 4 runs at 20" in speeds.note(15.6)
    assert speeds.note(15.0).endswith("; the mean is over all of them")
    many = speeds_of([*np.repeat(np.arange(9.0), 3) * 1000], labels_of((3,) * 9))
    assert many is not None and many.ranges.endswith("3 runs at 5,000, and 3 outcomes more")


def test_values_that_are_none_are_refused() -> None:
    """As shapes that do not agree are."""
    with pytest.raises(ValueError, match="finite"):
        p_value([1.0, np.nan], [0, 1])
    with pytest.raises(ValueError, match="shapes"):
        p_value([1.0, 2.0], [0])


def test_ranges_that_touch_are_not_apart() -> None:
    """Let values go with no outcome whose range ends where another's begins, on either side."""
    lower, higher = [1.0, 2.0, 3.0, 4.0, 5.0], [5.0, 6.0, 7.0, 8.0, 9.0]
    assert p_value(lower + higher, labels_of((5, 5))) == p_value(higher + lower, labels_of((5, 5))) == 1.0
    assert p_value([*lower[:-1], 4.9, *higher], labels_of((5, 5))) <= ALPHA
