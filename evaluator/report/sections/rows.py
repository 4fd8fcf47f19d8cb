"""What rows of the report's tables share: a group's name and facets, reasons written once, and cells of metrics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import Any

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render import numbers
from gpusimbench.evaluator.render.document import (
    EMPTY,
    NONE,
    Block,
    Cell,
    Column,
    Figure,
    Gallery,
    Item,
    Items,
    Row,
    Section,
    Table,
    Tone,
    items,
    key_of,
)
from gpusimbench.evaluator.render.figures.matrix import letter
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.metric import Estimate, Metric
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import GroupKey
from gpusimbench.evaluator.runs.labels import short_device
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

Written = Callable[[GroupResult], Cell]
"""Writes the cell of a group in a column."""

FEW = 5
"""Groups that are listed at once; of more, a summary stands before the closed list."""
_NAMED = 3  # groups whose absence a caption explains by name


def without(title: str, reasons: Iterable[str]) -> Missing:
    """What stands for a section of that title for which no group has what it needs; each reason once."""
    return Missing(f"{title}: {'; '.join(dict.fromkeys(reasons))}")


def facets(key: GroupKey) -> dict[str, str]:
    """By what readers filter the rows of a group or of a sweep."""
    return {"simulator": key.simulator, "scene": key.scene, "device": key.device or "none", "level": key.determinism}


def named(source: Source, result: GroupResult) -> Cell:
    """The name of a group, linked to its simulator; below it version, scene, device and runs that are not complete."""
    key, group = result.group.key, result.group
    trouble = words.trouble(group)
    notes = [f"{key.version or 'no version'}; {key.scene}; {key.device or 'no device'}"]
    notes += [f"{trouble} of {plural(len(group.recordings), 'run')}"] if trouble else []
    return Cell(source.names[result.label], notes=tuple(notes), link=key_of("simulator", key.simulator))


def places(results: Sequence[GroupResult]) -> list[tuple[Column, Written]]:
    """Columns that stand behind the names of groups: scene and device, where they differ, and the size."""
    keys = [r.group.key for r in results]
    found: list[tuple[Column, Written]] = []
    if len({key.scene for key in keys}) > 1:
        found.append((Column("scene", place=True), lambda r: Cell(r.group.key.scene)))
    if len({key.device for key in keys}) > 1:
        found.append((Column("device", place=True), lambda r: Cell(short_device(r.group.key.device) or NONE)))
    found.append((Column("envs x runs", "environments of a run, and complete runs", place=True), _size))
    return found


def _size(result: GroupResult) -> Cell:
    n_env = result.group.key.n_env
    return Cell(f"{n_env:,} x {len(result.group.complete)}", float(n_env))


def footnotes(source: Source, results: Iterable[GroupResult]) -> list[str]:
    """The footnotes that names of groups have marks of, a line each."""
    found = dict.fromkeys(r.footnotes for r in results if r.footnotes)
    return [f"{source.marks[said]} {'; '.join(said)}" for said in found]


class Reasons:
    """Reasons why values are missing: a cell has a letter, the legend of its table has the words."""

    def __init__(self) -> None:
        self._letters: dict[str, str] = {}

    def cell(self, why: str, text: str = EMPTY.text) -> Cell:
        """A cell without a value."""
        if not why:
            return EMPTY
        return Cell(text, notes=(self.mark(why),), tone=Tone.QUIET)

    def mark(self, why: str) -> str:
        """The letter of a reason, in brackets."""
        return self._letters.setdefault(why, f"({letter(len(self._letters)).lower()})")

    @property
    def legend(self) -> tuple[str, ...]:
        """A line for each reason, in the order in which they were given."""
        return tuple(f"{mark} {why}" for why, mark in self._letters.items())


def titled(source: Source, figures: Iterable[Figure]) -> list[Figure]:
    """Figures of groups of one scene with the groups' titles in place of their labels."""
    titles = {r.label: source.title(r) for r in source.shown}
    return [replace(one, label=titles.get(one.label, one.label)) for one in figures]


def footnotes_below(source: Source, results: Iterable[GroupResult]) -> tuple[Items, ...]:
    """The footnotes that titles have marks of, closed."""
    lines = footnotes(source, results)
    return (Items((Item("Footnotes", items=tuple(map(Item, lines))),)),) if lines else ()


def with_lines(figures: Iterable[Figure]) -> tuple[Gallery | Items, ...]:
    """Figures that have a drawing in a grid, and below it what is said in place of the others, each sentence once."""
    found = list(figures)
    drawn = tuple(one for one in found if one.svg)
    lines = lines_of([(one.caption, one.label) for one in found if not one.svg])
    return (*([Gallery(drawn, least=20.0)] if drawn else []), *([lines] if lines else []))


def lines_of(said: Sequence[tuple[str, str]]) -> Items | None:
    """Sentences with the groups that they hold for, each sentence once; None without any.

    said  sentence and label of a group, the latter empty where it is of the whole set
    """
    order = {sentence: nth for nth, sentence in enumerate(dict.fromkeys(sentence for sentence, _ in said))}
    in_order = sorted(said, key=lambda one: order[one[0]])
    found = []
    for sentence, of in groupby(in_order, key=lambda one: one[0]):
        labels = [label for _, label in of if label]
        if len(labels) < 2:
            found.append(Item(": ".join([*labels, sentence])))
        else:
            found.append(Item(f"{plural(len(labels), 'group')}: {sentence}", items=tuple(map(Item, labels))))
    return Items(tuple(found)) if found else None


def to_compare(section: str, notes: Sequence[Item | str]) -> Section:
    """A folded section of notes: conditions other than the simulator that the numbers of a section depend on."""
    title, said = "What must be known to compare them", plural(len(notes), "note")
    return Section(f"{section}-remarks", title, (items(*notes),), said, folded=True)


def absences(reasons: Mapping[str, Sequence[str]]) -> str:
    """Groups that a figure does not show, by reason: up to _NAMED groups by name, of more groups their number."""
    return "; ".join(
        f"{', '.join(names) if len(names) <= _NAMED else plural(len(names), 'group')} ({why})"
        for why, names in reasons.items()
    )


def by_simulator(key: str, parts: Sequence[tuple[GroupResult, Section]]) -> tuple[Section, ...]:
    """Sections of groups in a closed section for each simulator; as they are where a reader sees them at once.

    key    begins the keys of the sections
    """
    names = dict.fromkeys(result.group.key.simulator for result, _ in parts)
    if len(parts) <= FEW or len(names) < 2:
        return tuple(part for _, part in parts)
    made = []
    for name in names:
        of = tuple(part for result, part in parts if result.group.key.simulator == name)
        said = plural(len(of), "group")
        made.append(Section(key_of(key, "of", name), name, of, said, folded=True, facets={"simulator": name}))
    return tuple(made)


def ordered(results: Iterable[GroupResult], name: str) -> dict[Any, list[GroupResult]]:
    """Groups by what their key has under a name, in the order in which they come."""
    return gathered((getattr(result.group.key, name), result) for result in results)


def value(found: Estimate, reasons: Reasons, *notes: str, tone: Tone = Tone.PLAIN) -> Cell:
    """An estimate as its metric is written; without a value, the letter of the reason."""
    if isinstance(found.value, Missing):
        return reasons.cell(found.value.reason)
    shown = numbers.interval(found) if found.ci95 else ""
    said = tuple(note for note in notes if note and note != numbers.NONE)
    return Cell(words.cell(found), float(found.value), found.ci95 or None, shown, said, tone)


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
    left_out = gathered(
        (why, title.title)
        for i, title in enumerate(titles)
        if title not in whole.columns and (why := _why_empty(rows, i, reasons))
    )
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
