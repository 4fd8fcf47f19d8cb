"""The documents of a comparison as data: what the short one lists and counts, and what a comment leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from gpusimbench.evaluator.compare import document
from gpusimbench.evaluator.compare.compare import ComparedConfiguration, Result
from gpusimbench.evaluator.compare.document import comment, full, short
from gpusimbench.evaluator.compare.finding import Change, Finding, Settings
from gpusimbench.evaluator.compare.numbers import Schedule
from gpusimbench.evaluator.render.document import Block, Document, Items, Section, Table, Text, Tone, walk
from gpusimbench.evaluator.results.metric import Axis, Direction

SETTINGS = Settings(gates=frozenset({Axis.THROUGHPUT, Axis.MEMORY}))
FAILS, CHANGED = Change.REGRESSION, Change.CHANGED


def finding(change: Change, name: str, axis: Axis = Axis.THROUGHPUT, **more: Any) -> Finding:
    """A finding that is titled by its name."""
    return Finding(axis, name, name, change, Direction.HIGHER, **more)


def configuration(label: str, *findings: Finding, warnings: Sequence[str] = (), **pair: Any) -> ComparedConfiguration:
    """A configuration of that label, with two runs a side that were made in turn."""
    group = SimpleNamespace(key=SimpleNamespace(n_env=4, scene="cart", dt=0.01))
    given: Any = SimpleNamespace(**{"label": label, "base": group, "head": group, "differs": (), **pair})
    order = Schedule((), (False, True, False, True), (0, 0, 1, 1), known=True)
    return ComparedConfiguration(given, order, findings, tuple(warnings), ())


def result(*compared: ComparedConfiguration, notes: Sequence[str] = ()) -> Result:
    """A comparison of these configurations."""
    return Result(compared, (), (), SETTINGS, 0, 0, tuple(notes))


def rows_of(table: Table) -> list[str]:
    """The first cells of a table."""
    return [row.cells[0].text for row in table.rows]


def listed(found: Document | Sequence[Block], tone: Tone) -> list[str]:
    """What items of that tone say."""
    blocks = walk(found.blocks if isinstance(found, Document) else found)
    return [item.text for block in blocks if isinstance(block, Items) for item in block.items if item.tone is tone]


def differences(found: Document) -> Table:
    """The table of what fails, is undecided or differs."""
    (table,) = (block for block in walk(found.blocks) if isinstance(block, Table) and block.key == "differences")
    return table


@pytest.mark.parametrize(("count", "legend"), [(5, ()), (6, ("and 1 more",)), (9, ("and 4 more",))])
def test_five_rows_are_shown(count: int, legend: tuple[str, ...]) -> None:
    """Show five rows of what differs, and count the others; all of them where all is asked for."""
    names = [f"q{number}" for number in range(count)]
    found = result(configuration("a", *(finding(FAILS, name) for name in names)))
    table = differences(short(found))
    assert (rows_of(table), table.legend) == (names[:5], legend)
    table = differences(full(found, "gsb-compare"))
    assert (rows_of(table), table.legend) == (names, ())


def test_what_fails_comes_first() -> None:
    """List what fails before what is undecided and what differs, and name what needs no number by its verdict."""
    found = result(
        configuration(
            "a",
            finding(CHANGED, "differs", Axis.BUILD),
            finding(Change.UNCLEAR, "open", left_open=(FAILS,)),
            finding(Change.NOT_COMPARED, "not there", Axis.MEMORY, missing="no GPU"),
            finding(Change.SAME, "one"),
            finding(Change.UNCLEAR, "no gate", Axis.BUILD),
            finding(Change.SAME, "two"),
            finding(FAILS, "fails"),
        )
    )
    told = short(found)
    assert rows_of(differences(told)) == ["fails", "open", "differs"]
    assert listed(told, Tone.QUIET) == ["the same: one, two", "no difference shown: no gate"]
    assert listed(told, Tone.WARNING) == ["undecided: open: too few runs", "1 more reason"]
    assert differences(told).columns[0].title == "quantity"
    (section,) = (block for block in full(found).blocks if isinstance(block, Section) and block.key != "how")
    assert section.summary == "FAILED, 1 finding"
    assert listed([section], Tone.QUIET)[-1] == "not compared: not there: no GPU"
    (quantities,) = (block for block in section.blocks if isinstance(block, Table))
    assert "not there" not in rows_of(quantities)


@pytest.mark.parametrize(
    ("count", "shown", "more"), [(0, 0, []), (2, 2, []), (3, 2, ["1 more warning"]), (5, 2, ["3 more warnings"])]
)
def test_two_warnings_are_shown(count: int, shown: int, more: list[str]) -> None:
    """Give two warnings, each once whatever the number of configurations, and count the others."""
    warnings = [f"number {number}" for number in range(count)]
    told = short(result(*(configuration(name, finding(Change.SAME, "q"), warnings=warnings) for name in "ab")))
    assert listed(told, Tone.WARNING) == [*(f"warning: {one}" for one in warnings[:shown]), *more]


@pytest.mark.parametrize(("count", "more"), [(1, []), (2, ["1 more note"]), (4, ["3 more notes"])])
def test_one_note_is_shown(count: int, more: list[str]) -> None:
    """Give a note on the sets, and count the others; give all where all is asked for."""
    notes = [f"number {number}" for number in range(count)]
    found = result(configuration("a", finding(Change.SAME, "q")), notes=notes)
    assert listed(short(found), Tone.QUIET) == ["the same: q", "note: number 0", *more]
    assert [f"note: {note}" for note in notes] == [one for one in listed(full(found), Tone.PLAIN) if "note: " in one]


def test_several_configurations_are_told_apart() -> None:
    """Name the configuration of each row where there are several, and say of a single one what it is."""
    one, other = (
        configuration(name, finding(CHANGED, f"of {name}", Axis.BUILD), differs=("x: 1 -> 2",)) for name in "ab"
    )
    told = short(result(one, other))
    assert rows_of(differences(told)) == ["a, cart, 4 envs, dt 0.01 s", "b, cart, 4 envs, dt 0.01 s"]
    assert len([block for block in told.blocks if isinstance(block, Text)]) == 2
    texts = [block.text for block in short(result(one)).blocks if isinstance(block, Text)]
    runs = "2 complete runs of base, 2 of head, in the order ABAB (A base, B head)"
    assert texts[1:3] == [f"a, cart, 4 envs, dt 0.01 s: {runs}", "differs: x: 1 -> 2"]


def test_a_comment_has_room_for_some(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the configurations that fail first, as many as there is room for, and count those that are left out."""
    fine = [configuration(f"fine{number}", finding(Change.SAME, "q")) for number in range(3)]
    worse = configuration("worse", finding(FAILS, "q"))
    found = result(*fine, worse)

    def sections(told: Document) -> list[str]:
        return [b.title.partition(",")[0] for b in told.blocks if isinstance(b, Section) and b.key != "how"]

    def counted(told: Document) -> list[str]:
        return [block.text for block in told.blocks if isinstance(block, Text) and "left out" in block.text]

    every = ["worse", "fine0", "fine1", "fine2"]
    assert (sections(comment(found, "c")), counted(comment(found, "c"))) == (every, [])
    sizes = [
        len(document.render_markdown(Document("", (document._section(one, number, found, 300),))))
        for number, one in enumerate((worse, *fine))
    ]
    for shown, said in ((4, []), (3, ["and 1 more configuration, left out for their size"]),
                        (1, ["and 3 more configurations, left out for their size"])):  # fmt: skip
        monkeypatch.setattr(document, "_ROOM", sum(sizes[:shown]))
        told = comment(found, "c")
        assert (sections(told), counted(told)) == (every[:shown], said)
        assert sections(full(found, "c")) == every


def test_long_texts_are_cut() -> None:
    """Cut what a stranger wrote where there is little room, and only there."""
    long = configuration("x" * 500, finding(FAILS, "q"), warnings=["y" * 500], differs=("z" * 500,))
    told = short(result(long))
    lengths = [len(block.text) for block in told.blocks if isinstance(block, Text)][1:3]
    assert lengths == [300 + len(": 2 complete runs of base, 2 of head, in the order ABAB (A base, B head)"), 200]
    assert [len(line) for line in listed(told, Tone.WARNING)] == [300]
    whole = full(replace(result(long), notes=("n" * 500,)))
    assert {len(line) for line in listed(whole, Tone.WARNING)} == {500 + len("warning: ")}
    assert "note: " + "n" * 500 in listed(whole, Tone.PLAIN)
