"""Cells of metrics in the report's tables: the value as its metric is written, its interval, and what must be known."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.document import Cell, Column, Row, Table, Tone
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import Reasons, facets, named
from gpusimbench.evaluator.results.metric import Estimate, Metric
from gpusimbench.evaluator.results.result import GroupResult

Written = Callable[[GroupResult], Cell]


def value(found: Estimate, reasons: Reasons, *notes: str, tone: Tone = Tone.PLAIN) -> Cell:
    """An estimate as its metric is written; without a value, the letter of the reason."""
    if isinstance(found.value, Missing):
        return reasons.cell(found.value.reason)
    bounds = numbers.interval(found)
    shown = "" if bounds == numbers.NONE else bounds
    said = tuple(note for note in notes if note and note != numbers.NONE)
    return Cell(words.cell(found), float(found.value), found.ci95, shown, said, tone)


def of_groups(
    key: str, caption: str, results: Iterable[GroupResult], columns: Sequence[tuple[Column, Written]],
    reasons: Reasons, legend: Sequence[str] = (),
) -> Table:  # fmt: skip
    """A table with a row for each group, without the columns in which no group has anything."""
    rows = tuple(Row((named(r), *(write(r) for _, write in columns)), facets(r)) for r in results)
    titles = (Column("group"), *(column for column, _ in columns))
    whole = Table(key, caption, titles, rows, tuple(legend)).without_empty_columns()
    left_out: dict[str, list[str]] = {}
    for i, title in enumerate(titles):
        if title not in whole.columns and (why := _why_empty(rows, i, reasons)):
            left_out.setdefault(why, []).append(title.title)
    marks = {note for row in whole.rows for one in row.cells for note in one.notes}
    used = [line for line in reasons.legend if line.split(" ")[0] in marks]
    missing = [f"no {', '.join(names)}: {why}" for why, names in left_out.items()]
    return replace(whole, legend=(*whole.legend, *used, *missing))


def _why_empty(rows: Sequence[Row], index: int, reasons: Reasons) -> str:
    """Why no group has a value in a column; empty where no reason is known."""
    notes = dict.fromkeys(note for row in rows for note in row.cells[index].notes)
    words_of = {line.split(" ")[0]: line.partition(" ")[2] for line in reasons.legend}
    return "; ".join(dict.fromkeys(words_of.get(note, note) for note in notes))


def column_of(
    metric: Metric, reasons: Reasons, beside: Callable[[GroupResult], Iterable[str]] = lambda _: ()
) -> tuple[Column, Written]:
    """The column of a metric; `beside` is what stands below a value."""
    return (
        Column(metric.titled, metric.method),
        lambda result: value(result.metrics[metric.name], reasons, *beside(result)),
    )
