"""Checks of mechanics as a section, in words and as JSON: what was measured, what is allowed, and whether it holds; and
motions that are known in closed form: measured, predicted, and the smallest change that would show."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from gpusimbench.evaluator.json_values import picked
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
from gpusimbench.evaluator.render.numbers import NONE, bounds
from gpusimbench.evaluator.report.sections.rows import Reasons, Written, of_groups, without
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.canonical import LARGEST, UNITS, Law, Sensitivity, Unmeasured
from gpusimbench.evaluator.results.fidelity import DEMANDED, CheckVerdict, Fidelity, FidelityRow
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.physics.facts import NEWEST, Measured
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

TITLES = ("check", "measured", "range", "allowed", "tolerance", "verdict")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")

_SAID = f"Tolerances are those of {NEWEST.value}."
_TONES = {CheckVerdict.HELD: Tone.GOOD, CheckVerdict.BROKEN: Tone.BAD}

_LAWS = ("simulator", "law", "envs", "measured", "predicted", "difference", "tolerance", "smallest change", "verdict")

_HOW_LAWS = (
    "Difference: measured minus predicted, mean over environments, with its 95 % interval. Held: the interval comes "
    "within the tolerance of zero. No verdict: nothing that the engine was given predicts the value, whose own "
    "interval and standard deviation (sd) over environments are shown. Smallest change: of a parameter of the engine, "
    "which two recordings of these environments, before and after the change, tell apart in 95 of 100 cases (rank-sum "
    "test, 5 %); in brackets, the change with which the law is BROKEN in 95 of 100 recordings. A law of counts has the "
    "chi-squared statistic of Pearson's test as its value, the degrees of freedom as its prediction, and the number of "
    "throws instead of environments."
)


def fidelity_record(one: Fidelity) -> dict[str, Any]:
    """One group's physics for JSON: every check by its key, with its verdict."""
    of_group = "label scene n_run n_env looked_at exactness checks_missing revision held checkable not_checkable"
    return {**picked(one, of_group), "checks": {row.check.key: _check(row) for row in one.rows}}


def _check(row: FidelityRow) -> dict[str, Any]:
    record = {**picked(row.check, "title unit demanded"), **picked(row, "verdict reason")}
    if row.found is None:
        return record
    values = {**picked(row.found, "mean least most"), "n_run": row.n_run}
    values |= {**picked(row.found, "count low high tolerance broken"), "of_runs": row.of_runs}
    return {**record, **values, "tolerance_formula": row.found.of, "notes": list(row.notes)}


def cells(row: FidelityRow) -> tuple[str, ...]:
    """A measured check as the texts of a table's row, in the order of its titles."""
    unit = f" [{row.check.unit}]" if row.check.unit else ""
    verdict = row.verdict.value.upper() if row.verdict is CheckVerdict.BROKEN else row.verdict.value
    found = row.found
    assert found is not None
    if found.broken:
        verdict += f" {found.broken} of {found.count}"
    if row.n_run < row.of_runs:
        verdict += f", measured in {row.n_run} of {plural(row.of_runs, 'run')}"
    spread = NONE if found.least == found.most else f"{number(found.least)} to {number(found.most)}"
    return row.check.title + unit, number(found.mean), spread, allowed(found), number(found.tolerance), verdict


def allowed(found: Measured) -> str:
    """What mechanics allows, without the tolerance."""
    if found.low is not None and found.high is not None:
        return number(found.low) if found.low == found.high else f"{number(found.low)} to {number(found.high)}"
    if found.high is not None:
        return f"at most {number(found.high)}"
    return f"at least {number(found.low)}" if found.low is not None else "any"


def number(value: float | None) -> str:
    """A number with four digits; a dash for none."""
    return NONE if value is None else f"{value:.4g}"


def remarks(one: Fidelity) -> list[str]:
    """Notes of the checks that were made, and why the others were not: what several checks have is said once."""
    noted = gathered((note, row.check.title) for row in one.rows for note in _in_ranges(row.notes))
    lines = [f"{', '.join(titles)}: {note}" for note, titles in noted.items()]
    reasons = gathered((row.reason, row.check.title) for row in one.of(CheckVerdict.NOT_APPLICABLE))
    return [*lines, *(f"not applicable: {', '.join(names)}: {why}" for why, names in reasons.items())]


def _in_ranges(notes: Sequence[str]) -> Iterator[str]:
    """Notes of several runs that differ in their numbers alone as one, each number as the range that it takes."""
    alike = gathered(
        (_NUMBER.sub("{}", note.replace("{", "(").replace("}", ")")), _NUMBER.findall(note)) for note in notes
    )
    for words, found in alike.items():
        ranges = (sorted(set(numbers), key=float) for numbers in zip(*found, strict=True))
        yield words.format(*(values[0] if len(values) == 1 else f"{values[0]} to {values[-1]}" for values in ranges))


def section(source: Source) -> Section | Missing | None:
    """A row for each group, those with a broken check first; Missing where no check applies to any group."""
    checked = [r for r in source.shown if r.fidelity.checkable]
    broken = [r for r in checked if r.fidelity.of(CheckVerdict.BROKEN)]
    if not source.shown:
        return None
    if all(r.fidelity.checks_missing for r in source.shown):
        return without("Mechanics", (r.fidelity.checks_missing for r in source.shown))
    ordered = sorted(source.shown, key=lambda r: r not in broken)
    said = "no group breaks a check" if checked else "no group could be checked"
    if broken:
        said = f"{len(broken)} of {plural(len(checked), 'group')} {'breaks' if len(broken) == 1 else 'break'} a check"
    columns: list[tuple[Column, Written]] = [
        (Column("checks held", f"by the tolerances of {NEWEST.value}"), checks_held),
        (Column("broken"), _broken),
    ]
    every = of_groups(
        source, "mechanics-groups", "", ordered, columns, Reasons(), [_SAID],
        more=lambda r: blocks(r, key_of("mechanics", r.label)),
    )  # fmt: skip
    every = replace(every, opened="An opened row shows what each check measured.")
    return Section("mechanics", "Mechanics", (every,), said, folded=True)


def checks_held(result: GroupResult) -> Cell:
    """How many checks of a group hold, of those that could be made, and how many of all could not be made."""
    found = result.fidelity
    if found.checks_missing:
        return Cell("not applicable", notes=(found.checks_missing,), tone=Tone.QUIET)
    if not found.checkable:
        return Cell("none could be made", tone=Tone.QUIET)
    looked = f"{found.looked_at} of {plural(found.n_env, 'env')}, {plural(found.n_run, 'run')}"
    notes = (f"{found.not_checkable} of {DEMANDED} not checkable", found.revision.value, looked)
    tone = Tone.BAD if found.held < found.checkable else Tone.GOOD
    return Cell(f"{found.held} of {found.checkable}", found.held / found.checkable, notes=notes, tone=tone)


def _broken(result: GroupResult) -> Cell:
    return cell(", ".join(row.check.title for row in result.fidelity.of(CheckVerdict.BROKEN)))


def blocks(result: GroupResult, key: str) -> Iterator[Block]:
    """What each check of a group measured, in tables whose keys begin with `key`, and what must be known of them."""
    told = [row for row in result.fidelity.rows if row.verdict is not CheckVerdict.NOT_APPLICABLE]
    demanded = [row for row in told if row.check.demanded]
    rest = [row for row in told if not row.check.demanded]
    if demanded:
        yield _table(key, "", demanded)
    if rest:
        yield _table(f"{key}-rest", "At rest at the sample time (mechanics does not demand it)", rest)
    if lines := remarks(result.fidelity):
        yield items(*lines)
    if not told and not lines:
        yield Text("No check could be made.", Tone.QUIET)


def _table(key: str, caption: str, rows: list[FidelityRow]) -> Table:
    return table(key, caption, TITLES, [_row(row) for row in rows])


def _row(row: FidelityRow) -> Row:
    assert row.found is not None
    title, mean, *others, verdict = cells(row)
    tone = _TONES.get(row.verdict, Tone.PLAIN)
    return Row((Cell(title), Cell(mean, row.found.mean), *map(Cell, others), Cell(verdict, tone=tone)))


def laws(source: Source) -> Section | None:
    """None without canonical scenes."""
    found = [law for result in source.shown for law in result.laws]
    if not found:
        return None
    measured = [law for law in found if isinstance(law, Law)]
    judged = [law for law in measured if law.held is not None]
    broken = sum(not law.held for law in judged)
    missing = [law for law in found if isinstance(law, Unmeasured)]
    said = ", ".join(
        [f"{broken} of {plural(len(judged), 'law')} broken"] * bool(judged)
        + [f"{len(measured) - len(judged)} without a verdict"] * (len(measured) > len(judged))
        + [f"{len(missing)} not measured"] * bool(missing)
    )
    shown = Table("canonical", "", tuple(map(Column, _LAWS)), tuple(Row(_law_cells(law)) for law in measured))
    reasons = (Text(f"{law.label}: {law.title} not measured: {law.reason}.", Tone.QUIET) for law in missing)
    return Section("canonical", "Laws in closed form", (Text(_HOW_LAWS), shown, *reasons), said, folded=True)


def _law_cells(law: Law) -> tuple[Cell, ...]:
    unit = f" [{law.unit}]" if law.unit else ""
    interval = bounds(law.ci95, "{:.3g}".format) if law.ci95 else ""
    changes = "; ".join(map(change, law.sensitivities))
    verdict = Cell("held", tone=Tone.GOOD) if law.held else Cell("BROKEN", tone=Tone.BAD)
    difference, predicted = Cell(NONE), Cell(NONE)
    if law.difference is None or law.predicted is None:
        verdict = Cell("no verdict", notes=(law.held_missing,), tone=Tone.QUIET)
        value = Cell(f"{law.measured:.5g} {interval}".rstrip(), law.measured, notes=(f"sd {law.sd:.2g}",))
    else:
        difference = Cell(f"{law.difference:.3g} {interval}".rstrip(), law.difference)
        value, predicted = Cell(f"{law.measured:.5g}", law.measured), Cell(f"{law.predicted:.5g}", law.predicted)
    envs = Cell(f"{law.count} of {law.of_envs}", law.count, notes=law.left_out)
    return (
        Cell(law.label), Cell(law.title + unit), envs,
        value, predicted, difference, Cell(f"{law.tolerance:.3g}", law.tolerance, notes=(law.tolerance_formula,)),
        Cell(changes or NONE), verdict,
    )  # fmt: skip


def change(one: Sensitivity) -> str:
    """A sensitivity in words."""
    if one.slope == 0:
        return f"insensitive to {one.parameter}"
    if one.least is None:
        return (
            f"no {one.parameter}{f' up to {100 * LARGEST:g} %' if one.parameter not in UNITS else ''} is sure to show"
        )
    broken = f" ({size(one.breaks, one.parameter)})" if one.breaks else ""
    return f"{one.parameter} {size(one.least, one.parameter)}{broken}"


def size(change: float, parameter: str) -> str:
    """A change of a parameter with its unit."""
    return f"{change:.2g} {UNITS[parameter]}" if parameter in UNITS else f"{100 * change:.2g} %"


def laws_sentence(laws: Sequence[Law | Unmeasured]) -> str:
    """The laws of one group in a sentence, which names those that are broken and those that were not measured."""
    measured = [law for law in laws if isinstance(law, Law)]
    judged = [law for law in measured if law.held is not None]
    broken = [law.said for law in judged if not law.held]
    said = [f"{laws[0].label}: {len(judged) - len(broken)} of {plural(len(judged), 'law')} in closed form held"]
    said += [f"BROKEN: {'; '.join(broken)}"] * bool(broken)
    unjudged = [law.said for law in measured if law.held is None]
    said += [f"without a verdict: {'; '.join(unjudged)}"] * bool(unjudged)
    missing = [f"{x.title}: {x.reason}" for x in laws if isinstance(x, Unmeasured)]
    said += [f"not measured: {'; '.join(missing)}"] * bool(missing)
    return "; ".join(said)
