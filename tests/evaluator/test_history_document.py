"""The documents and words of a history as data, from changes that are given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from gpusimbench.evaluator.compare.finding import Change, Finding, Settings
from gpusimbench.evaluator.compare.history import words
from gpusimbench.evaluator.compare.history.curves import Curve, Sample, Shift
from gpusimbench.evaluator.compare.history.document import full, short
from gpusimbench.evaluator.compare.history.history import Event, Fact, History, Traced
from gpusimbench.evaluator.compare.history.series import Point, _device
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Cell, Document, Items, Section, Table, Text, Tone, walk
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.evaluator.results.metrics import METRICS

FPS, HOST = METRICS["fps"], METRICS["host_memory_peak_increment"]


def finding(change: Change, name: str = "runs", axis: Axis = Axis.VALIDITY, **more: Any) -> Finding:
    """A finding that is titled by its name."""
    return Finding(axis, name, name, change, **{"said": ("", "is another"), **more})


def traced(label: str = "mine", *, facts: Sequence[Fact] = (), curves: Sequence[Curve] = (), points: int = 9) -> Traced:
    """A series at all points."""
    key = SimpleNamespace(simulator="sim", scene="cart", version="1")
    entries = tuple(SimpleNamespace(point=index, group=SimpleNamespace(key=key)) for index in range(points))
    series: Any = SimpleNamespace(label=label, heading=f"{label}, cart", device="CPU", key=key, entries=entries)
    return Traced(series, tuple(curves), tuple(facts))


def history(*series: Traced, notes: Sequence[str] = (), points: int = 9, **more: Any) -> History:
    """A history of these series over points v0, v1, ..."""
    named = tuple(Point(f"v{index}", f"2026-01-0{index + 1}T00:00:00Z", ()) for index in range(points))
    given = {"settings": Settings(), "gated": False, "tests": 0, "lost": 0, **more}
    return History(named, series, notes=tuple(notes), **given)


def lines(found: Document) -> list[str]:
    """The items of a document."""
    return [item.text for block in found.blocks if isinstance(block, Items) for item in block.items]


def changes(count: int, change: Change = Change.CHANGED, **more: Any) -> list[Fact]:
    """As many facts at points 1, 2, ..."""
    return [Fact(1 + index, index, finding(change, f"f{index}", **more)) for index in range(count)]


TAIL = "--all prints every curve, --html FILE draws them"


@pytest.mark.parametrize(
    ("count", "small", "tail"),
    [
        (0, 0, TAIL),
        (5, 0, TAIL),
        (6, 0, f"1 more changes; {TAIL}"),
        (5, 1, f"1 difference too small to count; {TAIL}"),
        (8, 2, f"3 more changes; 2 differences too small to count; {TAIL}"),
    ],
)
def test_five_changes_are_listed(count: int, small: int, tail: str) -> None:
    """List the five newest changes that count, and count the others and those that are small."""
    told = lines(short(history(traced(facts=[*changes(count), *changes(small, Change.SMALL)]))))
    newest = [f"v{1 + index}: changed: f{index}, is another" for index in reversed(range(count))]
    assert told == [*newest[:5], tail]


@pytest.mark.parametrize(("count", "more"), [(0, []), (2, []), (3, ["note: 1 more"]), (5, ["note: 3 more"])])
def test_two_notes_are_listed(count: int, more: list[str]) -> None:
    """List two notes, and count the others."""
    told = lines(short(history(traced(), notes=[f"n{index}" for index in range(count)])))
    assert told == [*(f"note: n{index}" for index in range(min(count, 2))), *more, TAIL]


def test_a_change_names_its_configuration_where_there_are_several() -> None:
    """Name the configuration behind a change, unless there is one alone."""
    one, other = traced("a", facts=changes(1)), traced("b", facts=changes(1))
    assert lines(short(history(one)))[0] == "v1: changed: f0, is another"
    assert lines(short(history(one, other)))[:2] == [f"v1: changed: f0, is another [{name}, cart]" for name in "ab"]


@pytest.mark.parametrize(
    ("facts", "said", "tone"),
    [
        ([], "NO CHANGE found over 9 points", Tone.PLAIN),
        (changes(8, Change.SMALL), "NO CHANGE found over 9 points", Tone.PLAIN),
        (changes(1), "1 other change over 9 points; none at the newest, v8", Tone.PLAIN),
        (changes(2, Change.REGRESSION), "2 regressions over 9 points; none at the newest, v8", Tone.PLAIN),
        (changes(8, Change.IMPROVEMENT), "8 improvements over 9 points; at the newest, v8: validity", Tone.PLAIN),
        (changes(8), "8 other changes over 9 points; at the newest, v8: validity", Tone.BAD),
        (
            [*changes(8, Change.REGRESSION), *changes(1), *changes(1, Change.IMPROVEMENT)],
            "8 regressions, 1 other change, 1 improvement over 9 points; at the newest, v8: validity",
            Tone.BAD,
        ),
    ],
)
def test_the_verdict(facts: Sequence[Fact], said: str, tone: Tone) -> None:
    """Count the changes that matter by their kinds, worst first, and say which of them are the newest point's."""
    verdict = short(history(traced(facts=facts))).blocks[0]
    assert isinstance(verdict, Text)
    assert (verdict.text, verdict.tone) == (said, tone)


def test_a_gate_that_fails() -> None:
    """Name the axes of what fails at the newest point, and how many changes these are."""
    settings = Settings(gates=frozenset({Axis.VALIDITY, Axis.MEMORY}))
    facts = [*changes(8), Fact(8, 7, finding(Change.CHANGED, "mechanics", Axis.PHYSICS))]
    one = history(traced(facts=facts), settings=settings, gated=True)
    assert words.headline(one) == "FAILED at v8: validity (1 change on axes with a gate)"
    both = history(traced(facts=[*facts, Fact(8, 7, finding(Change.REGRESSION, "m", Axis.MEMORY))]), settings=settings,
                   gated=True)  # fmt: skip
    assert words.headline(both) == "FAILED at v8: validity, memory (2 changes on axes with a gate)"
    assert words.headline(history(traced(points=1))).startswith("NOTHING COMPARED: ")


def curve(metric: Any = FPS, *values: float, shifts: Sequence[Shift] = (), **more: Any) -> Curve:
    """A curve of these values at points 0, 1, ..."""
    samples = tuple(Sample(index, value, None, 3, value) for index, value in enumerate(values))
    return Curve(metric, Axis.THROUGHPUT, samples, False, False, shifts=tuple(shifts), **more)


def shift(ratio: float | None = 0.5, ci95: tuple[float, float] | None = (0.25, 0.75), **more: Any) -> Shift:
    """A change at point 2."""
    return Shift(2, 1, Change.REGRESSION, 100.0, 50.0, ratio, ci95, **{"p_value": 0.01, **more})


@pytest.mark.parametrize(
    ("metric", "moved", "said"),
    [
        (FPS, shift(), "-50 % [-75 % to -25 %] (100 -> 50 env-steps/s)"),
        (FPS, shift(ci95=None), "-50 % (100 -> 50 env-steps/s)"),
        (HOST, shift(ratio=None), "100.00 -> 50.00 MB"),
        (METRICS["distinct_runs"], shift(ratio=None), "100 -> 50"),
    ],
)
def test_by_how_much_a_curve_changed(metric: Any, moved: Shift, said: str) -> None:
    """Give the ratio with its interval before the levels, where there is a ratio."""
    of = curve(metric, 100.0, 100.0, 50.0)
    event = Event(traced(), 2, 1, Axis.THROUGHPUT, "t", moved.change, curve=of, shift=moved)
    assert words.amount(event) == said
    assert words.amount(replace(event, shift=None)) == words.amount(replace(event, curve=None)) == ""


@pytest.mark.parametrize(
    ("fact", "said"),
    [
        (finding(Change.CHANGED, said=("1 of 2", "2 of 2")), "1 of 2 -> 2 of 2"),
        (finding(Change.CHANGED, said=("1 of 2", "")), "1 of 2"),
        (finding(Change.CHANGED, said=("", "2 of 2")), "2 of 2"),
        (
            finding(Change.CHANGED, said=("", ""), note="runs of a side of base and of head"),
            "runs of a point before and after",
        ),
        (finding(Change.CHANGED, "outcome", said=("0 within", "0 within, 2 between them")), "2 between them [cm]"),
    ],
)
def test_facts_in_words(fact: Finding, said: str) -> None:
    """Give what both sides say, or the only one, or the note, in which the sides are points."""
    assert words.amount(Event(traced(), 2, 1, fact.axis, fact.title, fact.change, finding=fact)) == said


def cells(table: Table, column: str) -> list[Cell]:
    """A column of a table."""
    at = [one.title for one in table.columns].index(column)
    return [row.cells[at] for row in table.rows]


def test_the_whole() -> None:
    """Give for every quantity its ends and changes, for every change its p, and for every point its files."""
    moved = (
        shift(p_value=0.0123),
        replace(shift(p_value=1e-13), point=1, previous=0),
        replace(shift(p_value=Missing("no noise")), point=1, previous=0),
    )
    curves = (
        curve(FPS, 100.0, 100.0, 50.0, shifts=moved),
        curve(HOST, 7.0, 9.0, 11.0, changes_missing="too large"),
        curve(METRICS["distinct_runs"]),
    )
    facts = [*changes(1), Fact(1, 0, finding(Change.SMALL, "f1", note="runs of a side"))]
    found = full(history(traced(curves=curves, facts=facts, points=3), points=3))
    tables = {block.key: block for block in walk(found.blocks) if isinstance(block, Table)}
    table = tables["changes"]
    assert [(cell.text, cell.tone) for cell in cells(table, "p")] == [
        ("0.012", Tone.PLAIN),
        ("< 1e-12", Tone.PLAIN),
        ("none", Tone.QUIET),
        *[("fact", Tone.QUIET)] * 2,
    ]
    assert [cell.text for cell in cells(table, "point")] == ["v2", "v1", "v1", "v1", "v1"]
    (quantities,) = (block for key, block in tables.items() if key.endswith("-quantities"))
    assert [cell.text for cell in cells(quantities, "points")] == ["3", "3", "0"]
    assert [cell.text for cell in cells(quantities, "first value")] == ["100", "7.00", "-"]
    assert [cell.text for cell in cells(quantities, "newest value")] == ["50", "11.00", "-"]
    assert [cell.text for cell in cells(quantities, "changes")] == ["v2: -50 % (regression)", "none", "none"]
    assert cells(quantities, "changes")[0].notes == ("v1: -50 % (regression)",) * 2
    assert cells(quantities, "smallest change visible at the next point")[1].text == "too large"
    points = tables["points-table"]
    assert [cell.text for cell in cells(points, "point")] == ["v0", "v1", "v2"]
    assert [cell.text for cell in cells(points, "versions")] == ["sim 1"] * 3
    (section,) = (block for block in found.blocks if isinstance(block, Section) and block.key.startswith("series"))
    told = ["v1: changed: f0, is another", "v1: differs, below threshold: f1, is another (runs of a point)"]
    assert [item.text for block in section.blocks if isinstance(block, Items) for item in block.items] == told
    assert section.summary == "CPU: 3 points, 4 changes"
    assert not section.folded


@pytest.mark.parametrize(
    ("built", "device"),
    [([("1", "A"), ("2", "B")], "B"), ([("1", "A"), ("", "B")], "A"), ([("", "A"), ("", "B")], "B")],
)
def test_the_device_of_a_curve(built: list[tuple[str, str]], device: str) -> None:
    """Name the device by the newest runs that were built, or else by the newest of all."""
    keys = [SimpleNamespace(version=version, device=name) for version, name in built]
    entries: Any = [SimpleNamespace(group=SimpleNamespace(key=key)) for key in keys]
    assert _device(entries) == device
