"""What is wrong with the set: files that are in no figure, rules of the protocol, notes, environments that failed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from gpusimbench.evaluator.check.rules.rule import PROTOCOL, Scope, load_rules
from gpusimbench.evaluator.read.failing import KINDS, EnvFailure, Failing
from gpusimbench.evaluator.render.document import (
    Block,
    Cell,
    Column,
    Item,
    Items,
    Row,
    Section,
    Table,
    Text,
    Tone,
    table,
)
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.evaluator.runs.groups import shown_status, status_notes
from gpusimbench.schemas.location import Location
from gpusimbench.schemas.provenance import OverflowBit
from gpusimbench.schemas.text import plural


def section(source: Source) -> Section | None:
    """None where nothing is wrong and nothing is to be noted."""
    evaluation = source.evaluation
    rows = list(_rows(evaluation))
    blocks: list[Block] = []
    if rows:
        blocks.append(
            table("problems", "Files that are in no figure, or that lost data", ["file", "what is wrong", "why"], rows)
        )
    if evaluation.unmet.count:
        rules = {rule.id: rule for rule in load_rules(PROTOCOL).rules}
        unmet = [rules[name] for name in evaluation.unmet.findings if name in rules]
        point = f"; a point: {Scope.point.value}" if any(rule.of is Scope.point for rule in unmet) else ""
        blocks.append(Text(f"Rules of {PROTOCOL} that are not met (gsb-check --protocol names the files{point}):"))
        found = sorted(evaluation.unmet.findings.items(), key=lambda one: (-one[1], one[0]))
        advice = {rule.id: f"{rule.broken} Fix: {rule.do}" for rule in unmet}
        said = (f"{rule}, {plural(count, 'finding')}: {advice.get(rule, '')}" for rule, count in found)
        blocks.append(Items(tuple(map(Item, said))))
    notes = [(note, "") for note in evaluation.notes] + [(note, label) for label, note in _notes(evaluation)]
    if notes:
        rows_of_notes = [*_by_note(notes)]
        listed = table("notes", "", ["note", "groups"], rows_of_notes)
        many = plural(len(rows_of_notes), "note")
        blocks.append(Section("notes-of-groups", "Notes", (listed,), many, folded=True) if blocks else listed)
    if not blocks:
        return None
    parts = []
    if rows:
        parts.append(f"{plural(len({row.cells[0].text for row in rows}), 'file')} with problems")
    if evaluation.unmet.count:
        parts.append(f"{plural(evaluation.unmet.count, 'finding')} of {PROTOCOL}")
    title = "What is wrong with this set" if parts else "Notes on this set"
    if notes:
        parts.append(plural(len(notes), "note"))
    return Section("problems", title, tuple(blocks), ", ".join(parts), folded=True)


def _by_note(notes: Sequence[tuple[str, str]]) -> Iterator[Row]:
    """A row for each note; the groups that it holds for stand below, where there are several."""
    groups: dict[str, list[str]] = {}
    for note, label in notes:
        groups.setdefault(note, []).extend([label] if label else [])
    for note, labels in groups.items():
        said = Cell("the whole set") if not labels else Cell(labels[0])
        if len(labels) > 1:
            said = Cell(plural(len(labels), "group"), float(len(labels)), notes=tuple(labels))
        yield Row((Cell(note), said))


def _rows(evaluation: Evaluation) -> Iterator[Row]:
    for failure in evaluation.unreadable:
        yield _row(failure.path, "could not be read", failure.error.advised)
    for result in evaluation.results:
        for recording in result.group.recordings:
            if recording.status != "complete":
                yield _row(recording.path, shown_status(recording), recording.reason or "no reason given")
            if why := recording.unconfirmed:
                yield _row(recording.path, "unconfirmed", why)
            for lost in recording.dropouts:
                yield _row(recording.path, "lost data", lost)


def _row(path: Path | Location, what: str, why: str) -> Row:
    return Row((Cell(path.name, code=True), Cell(what, tone=Tone.BAD), Cell(why)))


def _notes(evaluation: Evaluation) -> Iterator[tuple[str, str]]:
    for result in evaluation.results:
        own = status_notes(result.group)
        yield from ((result.label, note) for note in result.notes if note not in own)
        yield from ((result.label, note) for note in result.footnotes)


_FAILING_COLUMNS = (
    Column("env"),
    Column("step", "simulator step after which the failure first shows"),
    Column("what", "what happened first; of several things in one step, not finite, then overflow, is told"),
    Column("body", "body or joint"),
    Column("field", "of the state, and the component"),
    Column("value", "a position that is out of bounds is relative to the environment's origin [m]"),
    Column("kept steps", "whose states are in the recording"),
)


def failing_table(found: Sequence[tuple[str, Failing, Sequence[OverflowBit]]]) -> Table:
    """A row for each environment whose states are kept.

    found  of each recording its name, what failed, and what the engine's overflow bits are; one name is not shown
    """
    named = len(found) > 1
    rows = [
        [*([Cell(name, code=True)] if named else []), *_failing_cells(failure, bits)]
        for name, failing, bits in found
        for failure in failing.failures
    ]
    columns = [*([Column("recording")] if named else []), *_FAILING_COLUMNS]
    return table("failing", "Environments that failed first", columns, rows)


def counted(failing: Failing, n_env: int) -> str:
    """How many environments failed, and of what."""
    if not failing.total:
        return f"none of {plural(n_env, 'environment')} failed up to step {failing.last_step}"
    counts = ", ".join(f"{count} {kind}" for kind, count in zip(KINDS, failing.counts, strict=True) if count)
    kept = plural(len(failing.failures), "environment")
    return f"{failing.total} of {n_env} up to step {failing.last_step}: {counts}; states of {kept} are kept"


def _failing_cells(failure: EnvFailure, bits: Sequence[OverflowBit]) -> list[Cell]:
    names = [bit.name for bit in bits if failure.overflow >> bit.bit & 1]
    what = f"{failure.kind}: {', '.join(names)}" if names else failure.kind
    return [
        Cell(str(failure.env), float(failure.env)),
        Cell(str(failure.step), float(failure.step)),
        Cell(what, tone=Tone.BAD),
        Cell(failure.item or NONE),
        Cell(f"{failure.field} {failure.component}" if failure.field else NONE),
        Cell(f"{failure.value:.6g}" if failure.field else NONE),
        Cell(f"{failure.first_step} to {failure.first_step + failure.steps - 1}"),
    ]


def failing(source: Source) -> Section | None:
    """None where no run kept failing environments alone."""
    results = [*source.shown, *source.hidden]
    runs = [run for result in results for run in result.group.recordings if run.failing is not None]
    if not runs:
        return None
    said = [Item(f"{r.path.name}: {counted(r.failing, r.configuration.n_env)}") for r in runs if r.failing is not None]
    blocks: list[Block] = [Items(tuple(said))]
    found = [
        (r.path.name, r.failing, r.simulation.overflow_bits if r.simulation else ())
        for r in runs
        if r.failing is not None and r.failing.failures
    ]
    if found:
        blocks.append(failing_table(found))
    failed = sum(bool(run.failing and run.failing.total) for run in runs)
    title = f"environments failed in {failed} of {plural(len(runs), 'run')} that kept failing environments alone"
    return Section("failing", "Environments that failed", tuple(blocks), title, folded=False)
