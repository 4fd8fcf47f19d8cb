"""A table of a page: closed rows that a reader opens, columns that fit, and how to read it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from markupsafe import Markup

from gpusimbench.evaluator.render.document import NONE, Block, Cell, Row, Table, Tone
from gpusimbench.evaluator.render.templating import escaped

_FIRST_ROWS = 25  # rows that a table shows until a reader asks for all
_OPEN_ROWS = 4  # a table of more rows has each on a line, until a reader opens the row
_SHORT_LEGEND = 2  # lines; of more, a page shows that there are some
_LONG = 48  # characters of a cell that are cut to what its line has room for
_ROOM = 152  # characters of a row on a page of 1280 pixels
_GAP = 2  # characters that a column's edges take
_NAME, _LONGEST_NAME = 48, 90  # characters of the names of rows: what a page has room for, and what is one
_SMALL = 0.85  # width of an interval's character
_TIGHT = "An opened row shows its intervals."
_MARK = re.compile(r"\([a-z]{1,2}\)")

_EMPTY = Markup("")


def table_markup(block: Table, more: Callable[[Iterable[Block]], Markup]) -> Markup:
    """A table; nothing where it has no rows. `more` writes what is shown of a row once a reader opens it."""
    if not block.rows:
        return _EMPTY
    numeric = [
        bool(i) and all(row.cells[i].value is not None or row.cells[i].text == NONE for row in block.rows)
        for i in range(len(block.columns))
    ]
    heads = (
        Markup("<th{} scope=col{}>{}</th>").format(
            Markup(" class=num") if numeric[i] else _EMPTY,
            Markup(' title="{}"').format(escaped(column.meaning)) if column.meaning else _EMPTY,
            escaped(column.title),
        )
        for i, column in enumerate(block.columns)
    )
    closed = (len(block.rows) > _OPEN_ROWS or any(row.more for row in block.rows)) and not block.compact
    whole, tight = _unbroken_columns(block) if closed else ([], False)
    rows = [_row(row, numeric, block.compact, closed, tight, more) for row in block.rows]
    first = len(rows) if len(rows) <= _FIRST_ROWS + 1 else _FIRST_ROWS
    bodies, every = Markup("<tbody>\n{}\n</tbody>").format(Markup("\n").join(rows[:first])), _EMPTY
    if rows[first:]:
        bodies += Markup("<tbody class=rest>\n{}\n</tbody>").format(Markup("\n").join(rows[first:]))
        every = Markup("\n<details class=every><summary>Show all {} rows</summary></details>").format(len(rows))
    caption = Markup("<caption>{}</caption>\n").format(escaped(block.caption)) if block.caption else _EMPTY
    name = block.caption or block.key.replace("-", " ")
    kept = Markup(' data-whole="{}"').format(" ".join(map(str, whole))) if whole else _EMPTY
    if closed and (places := sum(column.place for column in block.columns)):
        kept += Markup(' data-places="{}"').format(places)
    classes = " compact" if block.compact else f" rows{' named' * _is_named(block)}{' tight' * tight}" if closed else ""
    return Markup(
        '<div class="table{}" role="region" tabindex="0" aria-label="{}"><table{}>\n{}<thead><tr>{}</tr></thead>\n'
        "{}</table>{}</div>{}"
    ).format(
        classes,
        escaped(name),
        kept,
        caption,
        _EMPTY.join(heads),
        bodies,
        every,
        _legend((*filter(None, [block.opened]), *block.legend, *([_TIGHT] if tight else []))),
    )


def _is_named(block: Table) -> bool:
    """Whether its rows have names, which are cut to what there is room for, and no sentences in place of names."""
    return max(len(row.cells[0].text) for row in block.rows) <= _LONGEST_NAME


def _unbroken_columns(block: Table) -> tuple[list[int], bool]:
    """Columns, from 1, whose cells are not broken: the narrowest first, as many as a page has room for.

    Also whether there is no room for intervals, which are not broken either.
    """
    cells = [*zip(*(row.cells for row in block.rows), strict=True)]
    wide = [max(len(f"{one.text} {one.range}".strip()) for one in column) for column in cells]
    words = [max(map(len, " ".join([title.title, *(one.text for one in column)]).split()), default=0)
             for title, column in zip(block.columns, cells, strict=True)]  # fmt: skip
    ranges = [max(round(_SMALL * len(one.range)) for one in column) for column in cells]
    least = [*map(max, words, ranges)]
    tight = sum(least) + _GAP * len(least) > _ROOM and least != words
    named = _is_named(block)
    if named:
        words[0] = least[0] = min(wide[0], _NAME)
    room = _ROOM - sum(words if tight else least) - _GAP * len(least)
    found = []
    for i in sorted(range(int(named), len(wide)), key=lambda i: wide[i]):
        longest = max(len(one.text) for one in cells[i]) if tight else wide[i]
        more = max(0, longest - (words if tight else least)[i])
        if longest <= _LONG and more <= room:
            found.append(i + 1)
            room -= more
    return sorted(found), tight


def _legend(lines: Sequence[str]) -> Markup:
    if not lines:
        return _EMPTY
    listed = Markup("<ul class=legend>{}</ul>").format(
        _EMPTY.join(Markup("<li>{}</li>").format(escaped(one)) for one in lines)
    )
    if len(lines) <= _SHORT_LEGEND:
        return Markup("\n") + listed
    return Markup("\n<details class=key><summary>How to read this table: {} notes</summary>{}</details>").format(
        len(lines), listed
    )


def _row(
    row: Row,
    numeric: Sequence[bool],
    compact: bool,
    closed: bool,
    tight: bool,
    more: Callable[[Iterable[Block]], Markup],
) -> Markup:
    """A row of a table; where rows are closed, its name opens it, and what it has to say stands in a row below it."""
    opens = bool(row.more) or (closed and any(map(_hides, row.cells)))
    opens |= tight and any(one.range for one in row.cells)
    cells = [_cell(one, i, numeric[i], compact, opens and not i, closed) for i, one in enumerate(row.cells)]
    shown = Markup("<tr{}>{}</tr>").format(data_attributes(row.facets), _EMPTY.join(cells))
    if not row.more:
        return shown
    return shown + Markup("\n<tr class=more><td colspan={}>{}</td></tr>").format(len(row.cells), more(row.more))


def _hides(said: Cell) -> bool:
    """Whether a closed row does not show all of a cell."""
    return len(said.text) > _LONG or not all(map(_MARK.fullmatch, said.notes))


def _cell(said: Cell, index: int, numeric: bool, compact: bool, opens: bool, closed: bool) -> Markup:
    classes = " ".join([*(["num"] if numeric else []), *([] if said.tone is Tone.PLAIN else [said.tone.value])])
    attributes = Markup(' class="{}"').format(classes) if classes else _EMPTY
    if said.value is not None:
        attributes += Markup(' data-v="{}"').format(f"{said.value:.9g}")
    if compact and len(said.lines) > 1:
        attributes += Markup(' title="{}"').format(escaped("; ".join(said.lines)))
    name = "th scope=row" if index == 0 else "td"
    shown = _opening(said) if opens else cell_content(said, closed=closed)
    return Markup("<{}{}>{}</{}>").format(Markup(name), attributes, shown, Markup(name[:2]))


def _opening(said: Cell) -> Markup:
    """The name of a row as what opens it: where the name is a link, that stands with what is opened."""
    plain = cell_content(replace(said, link="", range="", notes=()), closed=True)
    notes = [Markup("<small>{}</small>").format(escaped(one)) for one in said.notes]
    if said.link:
        notes.append(Markup('<small><a href="#{}">go to its section</a></small>').format(said.link))
    return Markup("<details class=row><summary>{}</summary></details>{}").format(plain, _EMPTY.join(notes))


def cell_content(said: Cell, *, closed: bool = False) -> Markup:
    """What a cell shows: its text, its range and its notes; `closed` cuts a long text to what its line has room for."""
    shown = escaped(said.text)
    if said.code:
        shown = Markup("<code>{}</code>").format(shown)
    if said.link:
        shown = Markup('<a href="#{}">{}</a>').format(said.link, shown)
    if closed and len(said.text) > _LONG:
        shown = Markup("<span class=long>{}</span>").format(shown)
    bounds = Markup("<small class=whole>{}</small>").format(escaped(said.range)) if said.range else _EMPTY
    notes = (
        Markup("<small{}>{}</small>").format(Markup(" class=mark") if _MARK.fullmatch(one) else _EMPTY, escaped(one))
        for one in said.notes
    )
    return shown + bounds + _EMPTY.join(notes)


def data_attributes(facets: Mapping[str, str]) -> Markup:
    """By what a reader filters a row or a section, as attributes of its element."""
    return _EMPTY.join(Markup(' data-{}="{}"').format(name, escaped(value)) for name, value in facets.items())
