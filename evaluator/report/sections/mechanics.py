"""Checks of mechanics: what was measured of each group, what mechanics allows, and whether it holds."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.render.document import Block, Cell, Row, Section, Table, Text, Tone, items, key_of, table
from gpusimbench.evaluator.render.numbers import plural
from gpusimbench.evaluator.report import fidelity
from gpusimbench.evaluator.report.sections.rows import facets
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.fidelity import FidelityRow, Verdict
from gpusimbench.evaluator.results.result import GroupResult

_TONES = {Verdict.HELD: Tone.GOOD, Verdict.BROKEN: Tone.BAD}


def section(source: Source) -> Section | None:
    """A folded part for each group, those with a broken check first."""
    checked = [r for r in source.shown if r.fidelity.of(Verdict.HELD) or r.fidelity.of(Verdict.BROKEN)]
    broken = [r for r in checked if r.fidelity.of(Verdict.BROKEN)]
    if not source.shown:
        return None
    ordered = sorted(source.shown, key=lambda r: r not in broken)
    said = "no group breaks a check" if checked else "no group could be checked"
    if broken:
        said = f"{len(broken)} of {plural(len(checked), 'group')} {'breaks' if len(broken) == 1 else 'break'} a check"
    return Section("mechanics", "Mechanics", tuple(map(of_group, ordered)), said, folded=True)


def of_group(result: GroupResult) -> Section:
    """What was checked of one group."""
    found = result.fidelity
    held, broken = len(found.of(Verdict.HELD)), len(found.of(Verdict.BROKEN))
    said = f"not applicable: {found.why_not}" if found.why_not else f"{held} of {held + broken} checks held"
    key = key_of("mechanics", result.label)
    heading = fidelity.heading(found)
    return Section(key, heading, tuple(_blocks(result, key)), said, folded=True, facets=facets(result))


def _blocks(result: GroupResult, key: str) -> Iterator[Block]:
    told = [row for row in result.fidelity.rows if row.verdict is not Verdict.NOT_APPLICABLE]
    demanded = [row for row in told if row.check.demanded]
    rest = [row for row in told if not row.check.demanded]
    if demanded:
        yield _table(key, "", demanded)
    if rest:
        yield _table(f"{key}-rest", "At rest at the sample time (mechanics does not demand it)", rest)
    if lines := fidelity.remarks(result.fidelity):
        yield items(*lines)
    if not told and not lines:
        yield Text("No check could be made.", Tone.QUIET)


def _table(key: str, caption: str, rows: list[FidelityRow]) -> Table:
    return table(key, caption, fidelity.TITLES, [_row(row) for row in rows])


def _row(row: FidelityRow) -> Row:
    title, mean, *others, verdict = fidelity.cells(row)
    return Row(
        (Cell(title), Cell(mean, row.mean), *map(Cell, others), Cell(verdict, tone=_TONES.get(row.verdict, Tone.PLAIN)))
    )
