"""Checks of mechanics: what was measured of each group, what mechanics allows, and whether it holds."""

from __future__ import annotations

from collections.abc import Iterator

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Column,
    Row,
    Section,
    Table,
    Text,
    Tone,
    cell,
    items,
    key_of,
    table,
)
from gpusimbench.evaluator.report import fidelity
from gpusimbench.evaluator.report.sections.rows import Reasons, Written, of_groups, without
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.fidelity import DEMANDED, FidelityRow, Verdict
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.physics.facts import NEWEST
from gpusimbench.schemas.text import plural

_SAID = f"An opened row shows what each check measured. Tolerances are those of {NEWEST.value}."
_TONES = {Verdict.HELD: Tone.GOOD, Verdict.BROKEN: Tone.BAD}


def section(source: Source) -> Section | Missing | None:
    """A row for each group, those with a broken check first; Missing where no check applies to any group."""
    checked = [r for r in source.shown if r.fidelity.checkable]
    broken = [r for r in checked if r.fidelity.of(Verdict.BROKEN)]
    if not source.shown:
        return None
    if all(r.fidelity.why_not for r in source.shown):
        return without("Mechanics", (r.fidelity.why_not for r in source.shown))
    ordered = sorted(source.shown, key=lambda r: r not in broken)
    said = "no group breaks a check" if checked else "no group could be checked"
    if broken:
        said = f"{len(broken)} of {plural(len(checked), 'group')} {'breaks' if len(broken) == 1 else 'break'} a check"
    columns: list[tuple[Column, Written]] = [
        (Column("checks held", f"by the tolerances of {NEWEST.value}"), held),
        (Column("broken"), _broken),
    ]
    every = of_groups(
        source, "mechanics-groups", "", ordered, columns, Reasons(), [_SAID],
        more=lambda r: blocks(r, key_of("mechanics", r.label)),
    )  # fmt: skip
    return Section("mechanics", "Mechanics", (every,), said, folded=True)


def held(result: GroupResult) -> Cell:
    """How many checks of a group hold, of those that could be made, and how many of all could not be made."""
    found = result.fidelity
    if found.why_not:
        return Cell("not applicable", notes=(found.why_not,), tone=Tone.QUIET)
    if not found.checkable:
        return Cell("none could be made", tone=Tone.QUIET)
    looked = f"{found.looked_at} of {plural(found.n_env, 'env')}, {plural(found.runs, 'run')}"
    notes = (f"{found.not_checkable} of {DEMANDED} not checkable", found.revision.value, looked)
    tone = Tone.BAD if found.held < found.checkable else Tone.GOOD
    return Cell(f"{found.held} of {found.checkable}", found.held / found.checkable, notes=notes, tone=tone)


def _broken(result: GroupResult) -> Cell:
    return cell(", ".join(row.check.title for row in result.fidelity.of(Verdict.BROKEN)))


def blocks(result: GroupResult, key: str) -> Iterator[Block]:
    """What each check of a group measured, in tables whose keys begin with `key`, and what must be known of them."""
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
