"""A comparison of two sets as a document: the verdict, what decides it, then everything; and as JSON."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import Any

from gpusimbench.evaluator.compare import words
from gpusimbench.evaluator.compare.compare import ComparedConfiguration, Result, counts
from gpusimbench.evaluator.compare.finding import Change, Finding
from gpusimbench.evaluator.json_values import document_of, dump, picked, values_of
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Code,
    Document,
    Item,
    Items,
    Section,
    Table,
    Text,
    Tone,
    items,
    key_of,
    table,
)
from gpusimbench.evaluator.render.markdown import render_markdown
from gpusimbench.evaluator.report.timed import timed_record
from gpusimbench.evaluator.results.metric import Axis
from gpusimbench.schemas.text import cut, plural

_ROWS, _REASONS, _WARNINGS, _NOTES = 5, 1, 2, 1
"""Rows of the table, reasons, warnings and notes that the short text has."""

_MOST_ROWS = 40
"""Rows of the table over all configurations."""

_ROOM = 40_000
"""Characters of Markdown for details: a comment on a pull request may have 65,536 in all."""

_LONGEST, _DIFFERS = 300, 200
"""Characters of a text in a comment or in the short text; the same of what differs between base and head."""

_ALIKE = {
    Change.SAME: "the same",
    Change.WITHIN: "no difference as large as the threshold",
    Change.UNCLEAR: "no difference shown",
}
"""Changes that the short text names without numbers."""


def short(result: Result) -> Document:
    """About fifteen lines: the verdict, what fails, is undecided or differs, and what a reader must be warned of."""
    blocks: list[Block] = [_verdict(result)]
    alone = result.compared[0] if len(result.compared) == 1 else None
    if alone:
        blocks.append(Text(f"{cut(words.heading(alone), _LONGEST)}: {words.runs(alone)}"))
        if alone.pair.differs:
            blocks.append(Text(cut(f"differs: {'; '.join(alone.pair.differs)}", _DIFFERS)))
    blocks.append(_remarkable(result, _ROWS, _LONGEST))
    if alone:
        blocks.append(items(*_alike(alone, result), *_bits_of_one_run(alone), tone=Tone.QUIET))
    told = dict.fromkeys(line for one in result.compared for line in words.undecided(one, result))
    blocks += [
        _first([f"undecided: {line}" for line in told], _REASONS, "reasons", Tone.WARNING),
        _first(
            [f"warning: {line}" for line in dict.fromkeys(line for one in result.compared for line in one.warnings)],
            _WARNINGS, "warnings", Tone.WARNING,
        ),
        _first(_left_out(result, _LONGEST), _NOTES, "notes", Tone.QUIET),
        Text("--all prints every quantity with its test, method and warnings", Tone.QUIET),
    ]  # fmt: skip
    return Document("", tuple(blocks))


def full(result: Result, command: str = "") -> Document:
    """Every quantity of every configuration, for --all."""
    return _full(result, command, len(result.compared), sys.maxsize)


def comment(result: Result, command: str) -> Document:
    """The same for a pull request, with as many configurations as a comment has room for, those that fail first."""
    room = _ROOM
    for count, one in enumerate(_ordered(result)):
        room -= len(render_markdown(Document("", (_section(one, count, result, _LONGEST),))))
        if room < 0:
            return _full(result, command, count, _LONGEST)
    return _full(result, command, len(result.compared), _LONGEST)


def _full(result: Result, command: str, count: int, longest: int) -> Document:
    """The first `count` configurations whole; before them what differs, where they are folded or are many."""
    blocks: list[Block] = [_verdict(result)]
    if command or len(result.compared) > 1:
        blocks.append(_remarkable(result, _MOST_ROWS, longest))
    if left := _left_out(result, longest):
        blocks.append(items(*left))
    blocks += [_section(one, number, result, longest) for number, one in enumerate(_ordered(result)[:count])]
    if count < len(result.compared):
        blocks.append(
            Text(f"and {plural(len(result.compared) - count, 'more configuration')}, left out for their size")
        )
    reading = (*words.methods(result.compared), *words.legend(result), words.settings_line(result))
    blocks.append(Section("how", "How to read this", (items(*reading, tone=Tone.QUIET),), folded=True))
    return Document("", tuple(blocks), made_by=(Code((command,)),) if command else ())


def _verdict(result: Result) -> Text:
    passed = result.comparable and not result.open
    return Text(words.sentence(result), Tone.BAD if result.failing else Tone.GOOD if passed else Tone.WARNING)


def _ordered(result: Result) -> list[ComparedConfiguration]:
    """The configurations, those that fail first."""
    return sorted(result.compared, key=lambda one: not any(f.fails(result.settings) for f in one.findings))


def _remarkable(result: Result, most: int, longest: int) -> Table:
    """What fails, is undecided or differs, in this order; rows behind `most` are counted."""
    rows = [
        (compared, finding)
        for compared in result.compared
        for finding in compared.findings
        if finding.change is not Change.NOT_COMPARED
        if finding.change not in _ALIKE or finding.undecided(result.settings)
    ]
    rows.sort(key=lambda row: (not row[1].fails(result.settings), not row[1].undecided(result.settings)))
    several = len(result.compared) > 1
    shown = [
        [*([cut(words.heading(compared), longest)] if several else []), *_cells(finding, result)]
        for compared, finding in rows[:most]
    ]
    legend = [f"and {len(rows) - most} more"] if len(rows) > most else []
    columns = [*(["configuration"] if several else []), *_titles()]
    return table("differences", "", columns, shown, legend).without_empty_columns()


def _titles() -> list[str]:
    return ["quantity", *words.TITLES[1:]]


def _cells(finding: Finding, result: Result) -> list[Cell | str]:
    title, base, head, ratio, interval, p, verdict = words.cells(finding, result)
    tone = Tone.BAD if finding.fails(result.settings) else Tone.PLAIN
    return [
        title,
        Cell(base, None if finding.said[0] else finding.base),
        Cell(head, None if finding.said[1] else finding.head),
        Cell(ratio, finding.ratio, finding.ci95),
        interval,
        Cell(p, finding.p_adjusted),
        Cell(verdict, tone=tone),
    ]


def _alike(compared: ComparedConfiguration, result: Result) -> Iterator[str]:
    """The quantities that need no number, a line for each verdict."""
    for change, said in _ALIKE.items():
        titles = [f.title for f in compared.findings if f.change is change and not f.undecided(result.settings)]
        if titles:
            yield f"{said}: {', '.join(titles)}"


def _bits_of_one_run(compared: ComparedConfiguration) -> Iterator[str]:
    """Where the only run of head leaves the only run of base; of several runs, the table says it."""
    if compared.order.n == (1, 1):
        for finding in compared.findings:
            if finding.axis is Axis.BITS and finding.change is Change.NOT_COMPARED:
                yield f"not compared: {finding.title}: {finding.missing}"


def _first(lines: Sequence[str], most: int, what: str, tone: Tone) -> Items:
    """The first lines, and how many more there are."""
    shown = [Item(cut(one, _LONGEST), tone) for one in lines[:most]]
    if len(lines) > most:
        shown.append(Item(f"{len(lines) - most} more {what if len(lines) - most > 1 else what[:-1]}", tone))
    return Items(tuple(shown))


def _left_out(result: Result, longest: int) -> list[str]:
    """What was not compared at all, and notes on the sets."""
    lines = [f"not read: {side}: {unreadable.error}" for side, unreadable in result.unreadable]
    lines += [f"without a partner: {label} of {side}: {why}" for side, label, why in result.alone]
    return [cut(line, longest) for line in (*lines, *(f"note: {note}" for note in result.notes))]


def _section(compared: ComparedConfiguration, number: int, result: Result, longest: int) -> Section:
    """One configuration: every quantity, then warnings, then how the quantities were tested."""
    failing = sum(finding.fails(result.settings) for finding in compared.findings)
    undecided = words.undecided(compared, result)
    summary = f"FAILED, {plural(failing, 'finding')}" if failing else "undecided" if undecided else "passed"
    rows = [_cells(f, result) for f in compared.findings if f.change is not Change.NOT_COMPARED]
    remarks = [
        *(Item(cut(f"warning: {line}", longest), Tone.WARNING) for line in compared.warnings),
        *(Item(f"undecided: {line}", Tone.WARNING) for line in undecided),
        *(Item(cut(line, longest), Tone.QUIET) for line in (*words.tests(compared), *words.remarks(compared))),
    ]
    differs = [Text(cut(f"differs: {one}", longest)) for one in compared.pair.differs]
    blocks: tuple[Block, ...] = (
        Text(words.runs(compared)), *differs,
        table(key_of("quantities", number), "", _titles(), rows).without_empty_columns(),
        Items(tuple(remarks)),
    )  # fmt: skip
    heading = cut(words.heading(compared), longest)
    return Section(key_of("configuration", number), heading, blocks, summary=summary, folded=True)


def dump_json(result: Result) -> str:
    """The document as text."""
    settings = result.settings
    return dump(
        document_of({
            "verdict": words.headline(result),
            "exit_code": int(result.exit_code),
            "undecided": [axis.value for axis in result.undecided],
            "settings": {
                **picked(settings, "alpha threshold outcome_cm"),
                "gates": [axis.value for axis in Axis if axis in settings.gates],
                "expect_same": settings.expect_same,
                "statistical_comparisons": result.tests,
            },
            "compared": [_configuration(compared, result) for compared in result.compared],
            "without_partner": [{"side": s, "label": label, "reason": why} for s, label, why in result.alone],
            "unreadable": [
                {"side": side, "file": values_of(u.path), "reason": str(u.error)} for side, u in result.unreadable
            ],
            "notes": list(result.notes),
        })
    )  # fmt: skip


def _configuration(compared: ComparedConfiguration, result: Result) -> dict[str, Any]:
    pair = compared.pair
    sides = {
        name: {
            **picked(group.key, "version device"),
            "n_run": len(group.complete),
            "outcomes": group.outcomes,
            "timed": timed_record(work),
            "recordings": [
                {"file": values_of(r.path), **picked(r.provenance, "run_id created_utc"), **picked(r, "status")}
                for r in group.recordings
            ],
        }
        for name, group, work in zip(("base", "head"), (pair.base, pair.head), compared.timed, strict=True)
    }
    return {
        "label": pair.label,
        **picked(pair.base.key, "simulator scene n_env dt"),
        **sides,
        **picked(pair, "differs same_machine"),
        "order": "".join("B" if head else "A" for head in compared.order.head),
        "interleaved": compared.order.interleaved,
        "findings": [_finding(finding, result) for finding in compared.findings],
        "warnings": list(compared.warnings),
        "notes": list(compared.notes),
    }


def _finding(finding: Finding, result: Result) -> dict[str, Any]:
    record: dict[str, Any] = values_of(finding)
    return {
        **record,
        "said": dict(zip(("base", "head"), finding.said, strict=True)),
        "n": dict(zip(("base", "head"), finding.n, strict=True)),
        "gated": counts(finding.axis, result.settings),
        "fails": finding.fails(result.settings),
        "undecided": finding.undecided(result.settings),
    }
