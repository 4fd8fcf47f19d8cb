"""Verdicts of groups, and how they are shown."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from gpusimbench.evaluator.compare.counted import compare_mechanics
from gpusimbench.evaluator.compare.finding import Change
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Document, facts
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.sections.mechanics import blocks, checks_held, fidelity_record
from gpusimbench.evaluator.results.fidelity import CheckVerdict, Fidelity, fidelity
from gpusimbench.evaluator.runs.physics.facts import Check, PhysicsFacts, measured


def printed(found: Fidelity) -> str:
    """What a terminal shows of a group's mechanics."""
    stream = io.StringIO()
    result: Any = SimpleNamespace(
        label=found.label,
        fidelity=found,
        group=SimpleNamespace(key=SimpleNamespace(simulator="x", scene="s", device="d", determinism="default")),
    )
    print_document(Document("", (facts(("checks held", checks_held(result))), *blocks(result, "mechanics-of"))), stream)
    return stream.getvalue()


def run(*values: float, why: str = "") -> PhysicsFacts:
    """A run whose rolling was measured, or not."""
    fact = Missing(why) if why else measured(values, low=2.4, high=2.4, tolerance=0.05, of="a dt / T", note="seen")
    return PhysicsFacts("inclined-collision", 2, ((0, 1),), {Check.ROLLING: fact, Check.FALL: Missing("nothing falls")})


def test_one_broken_value_breaks_the_group() -> None:
    """Break where one environment of one run is beyond the tolerance, and count it."""
    row = fidelity("x", [run(2.4, 2.41), run(2.38, 2.46)]).rows[0]
    assert (row.verdict, row.found.broken, row.found.count, row.n_run) == (CheckVerdict.BROKEN, 1, 4, 2)
    assert row.found.mean == pytest.approx(2.4125)
    assert (row.found.least, row.found.most) == (2.38, 2.46)


def test_the_tolerance_belongs_to_what_is_held() -> None:
    """Hold on the edge of the tolerance."""
    assert fidelity("x", [run(2.449, 2.351)]).rows[0].verdict is CheckVerdict.HELD


def test_runs_that_could_not_be_measured_are_told() -> None:
    """Judge by those that could, and keep the reason of the others."""
    row = fidelity("x", [run(2.4), run(why="sparse")]).rows[0]
    assert (row.verdict, row.n_run, row.reason) == (CheckVerdict.HELD, 1, "sparse")
    none = fidelity("x", [run(why="sparse"), run(why="sparse")]).rows[0]
    assert (none.verdict, none.found, none.reason) == (CheckVerdict.NOT_APPLICABLE, None, "sparse")


def test_groups_without_facts_say_why() -> None:
    """Give the reason of the runs, or that there is none that can be used."""
    assert fidelity("x", []).checks_missing == "no run can be used"
    silent = replace(run(2.4), facts=Missing("no states were recorded"))
    assert fidelity("x", [silent, silent]).checks_missing == "no states were recorded"
    assert fidelity("x", [silent, run(2.4)]).rows[0].verdict is CheckVerdict.HELD


def test_a_value_that_is_not_finite_breaks() -> None:
    """Count it as broken, and keep it out of the mean."""
    fact = measured([2.4, float("nan")], low=2.4, high=2.4, tolerance=0.05, of="a dt / T")
    assert (fact.mean, fact.broken, fact.count) == (2.4, 1, 2)


def test_values_of_which_none_is_finite_break() -> None:
    """Count all as broken, give no number for them, and show that on every output."""
    fact = measured([float("nan"), float("inf")], low=2.4, high=2.4, tolerance=0.05, of="a dt / T")
    assert (fact.mean, fact.least, fact.most, fact.broken, fact.count) == (None, None, None, 2, 2)
    found = fidelity("x", [replace(run(2.4), facts={Check.ROLLING: fact})])
    (row,) = (row for row in found.rows if row.check is Check.ROLLING)
    assert (row.verdict, row.found.mean) == (CheckVerdict.BROKEN, None)
    assert "BROKEN 2 of 2" in printed(found)
    json.dumps(fidelity_record(found), allow_nan=False)
    both = fidelity("x", [replace(run(2.4), facts={Check.ROLLING: fact}), run(2.41)]).rows[0]
    assert (both.found.mean, both.found.broken, both.found.count) == (2.41, 2, 3)


def test_the_table_shows_what_broke() -> None:
    """Print measured, allowed, tolerance and verdict, and the reasons beneath."""
    text = printed(fidelity("engine x", [run(2.4, 2.0)]))
    assert "checks held 0 of 1 21 of 22 not checkable physics-2 2 of 2 envs, 1 run" in " ".join(text.split())
    assert "2 to 2.4" in text
    assert "BROKEN 1 of 2" in text
    assert "not applicable: acceleration of free fall: nothing falls" in text


def test_json_has_every_check() -> None:
    """Name each check with its verdict; what was not measured has a reason and no number."""
    record = json.loads(json.dumps(fidelity_record(fidelity("x", [run(2.4, 2.0)])), allow_nan=False))
    assert record["checks"]["rolling_acceleration"]["verdict"] == "broken"
    assert record["checks"]["rolling_acceleration"]["least"] == 2.0
    assert [record[key] for key in ("revision", "held", "checkable", "not_checkable")] == ["physics-2", 0, 1, 21]
    assert record["checks"]["fall_acceleration"] == {
        "title": "acceleration of free fall", "unit": "m/s2", "demanded": True, "verdict": "not applicable",
        "reason": "nothing falls",
    }  # fmt: skip


def test_what_mechanics_does_not_demand_is_shown_apart() -> None:
    """Tell of cubes that still spin, without counting or calling it a breach of mechanics."""
    spin = measured([3.0, 0.0], low=None, high=0.0, tolerance=0.5, of="1 cm/s of a corner")
    speed = measured([0.0, 0.0], low=None, high=0.0, tolerance=0.01, of="1 cm/s")
    found = fidelity("x", [replace(run(2.4), facts={**run(2.4).facts, Check.END_SPEED: speed, Check.END_SPIN: spin})])
    assert [row.check for row in found.of(CheckVerdict.MOVING)] == [Check.END_SPIN]
    assert [row.check for row in found.of(CheckVerdict.AT_REST)] == [Check.END_SPEED]
    text = printed(found)
    assert "checks held  1 of 1" in text
    held, apart = text.split("At rest at the sample time (mechanics does not demand it)", 1)
    assert "fastest spin" not in held
    assert "still moving 1 of 2" in apart
    assert "BROKEN" not in text
    record = fidelity_record(found)["checks"]["end_spin"]
    assert (record["demanded"], record["verdict"], record["broken"]) == (False, "still moving", 1)


def runs_of(*values: float) -> list[Any]:
    """As much of runs as a comparison reads, each with the value of rolling that it had."""
    captured = SimpleNamespace(phases=("capture",))
    return [SimpleNamespace(configuration=captured, physics=run(value)) for value in values]


@pytest.mark.parametrize(
    ("base", "head", "change"),
    [
        ((2.4, 2.4, 2.4), (2.4, 3.0, 3.0), Change.REGRESSION),
        ((3.0, 3.0, 2.4), (3.0, 2.4, 2.4), Change.IMPROVEMENT),
        ((3.0, 2.4), (3.0, 3.0, 3.0), Change.REGRESSION),
    ],
)
def test_runs_that_break_a_check_are_counted(base: Any, head: Any, change: Change) -> None:
    """Ask how often a check is broken on either side, where some runs of all break it."""
    (asked,) = compare_mechanics(runs_of(*base), runs_of(*head), certain=False)
    assert (asked.base, asked.head) == ((base.count(3.0), len(base)), (head.count(3.0), len(head)))
    assert (asked.finding.change, asked.finding.n) == (change, (len(base), len(head)))


@pytest.mark.parametrize(
    ("value", "said"), [(2.4, "1 of 1 held, 21 not checkable"), (3.0, "0 of 1 held, 21 not checkable")]
)
def test_a_check_that_every_run_says_the_same_of(value: float, said: str) -> None:
    """Ask nothing of a check that all runs hold, or all break."""
    (found,) = compare_mechanics(runs_of(value, value), runs_of(value), certain=False)
    assert (found.change, found.said, found.n) == (Change.SAME, (said, said), (2, 1))


def test_a_check_of_runs_that_are_all_alike() -> None:
    """Tell by the verdicts alone, where one run speaks for all of its side."""
    for base, head, change in ((2.4, 3.0, Change.REGRESSION), (3.0, 2.4, Change.IMPROVEMENT)):
        (found,) = compare_mechanics(runs_of(base, base), runs_of(head, head), certain=True)
        assert (found.change, found.name) == (change, "mechanics.rolling_acceleration")


def test_mechanics_that_one_side_alone_tells() -> None:
    """Leave mechanics open where one side says nothing of them, and out where neither does."""
    (told,), (silent,) = runs_of(2.4), runs_of(2.4)
    silent.physics = replace(silent.physics, facts=Missing("no states"))
    for base, head, applies in (
        ([told], [silent], True), ([silent], [told], True), ([], [told], True), ([told], [], True),
        ([silent], [silent], False),
    ):  # fmt: skip
        (found,) = compare_mechanics(base, head, certain=True)
        assert (found.change, found.applies) == (Change.NOT_COMPARED, applies)
