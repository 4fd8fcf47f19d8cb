"""Cells of metrics in the report's tables: the value as its metric is written, its interval, and what must be known."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.document import Block, Cell, Column, Row, Table, Tone
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import Reasons, Written, facets, footnotes, named, places
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.metric import Estimate, Metric
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.text import plural


def value(found: Estimate, reasons: Reasons, *notes: str, tone: Tone = Tone.PLAIN) -> Cell:
    """An estimate as its metric is written; without a value, the letter of the reason."""
    if isinstance(found.value, Missing):
        return reasons.cell(found.value.reason)
    bounds = numbers.interval(found)
    shown = "" if bounds == numbers.NONE else bounds
    said = tuple(note for note in notes if note and note != numbers.NONE)
    return Cell(words.cell(found), float(found.value), found.ci95, shown, said, tone)


def of_groups(
    source: Source, key: str, caption: str, results: Sequence[GroupResult], columns: Sequence[tuple[Column, Written]],
    reasons: Reasons, legend: Sequence[str] = (), *, with_any: bool = False,
    more: Callable[[GroupResult], Iterable[Block]] = lambda _: (),
) -> Table:  # fmt: skip
    """A table with a row for each group, without the columns in which no group has anything; no row without any column.

    with_any  leave out groups that have nothing in any column, and say how many these are
    more      what is shown of a group once a reader opens its row
    """
    of_place = places(results)
    written = [(r, [write(r) for _, write in columns]) for r in results]
    kept = [(r, own) for r, own in written if not with_any or any(one.text != numbers.NONE for one in own)] or written
    rows = tuple(
        Row((named(source, r), *(write(r) for _, write in of_place), *own), facets(r.group.key), tuple(more(r)))
        for r, own in kept
    )
    titles = (Column("group"), *(column for column, _ in (*of_place, *columns)))
    bare = len(written) - len(kept)
    legend = [*legend, *footnotes(source, (r for r, _ in kept))]
    legend += [f"{plural(bare, 'group')} without any of these values left out"] if bare and kept else []
    whole = Table(key, caption, titles, rows, tuple(legend)).without_empty_columns()
    left_out: dict[str, list[str]] = {}
    for i, title in enumerate(titles):
        if title not in whole.columns and (why := _why_empty(rows, i, reasons)):
            left_out.setdefault(why, []).append(title.title)
    marks = {note for row in whole.rows for one in row.cells for note in one.notes}
    used = [line for line in reasons.legend if line.split(" ")[0] in marks]
    missing = [f"no {', '.join(names)}: {why}" for why, names in left_out.items()]
    has_any = len(whole.columns) > 1 + len(of_place)
    return replace(whole, rows=whole.rows if has_any else (), legend=(*whole.legend, *used, *missing))


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
