"""A document as one HTML page that needs nothing but itself: no network, no other file.

Every text is a stranger's and is escaped here. The page's policy allows its own scripts by their digests and nothing
else; without scripts the page lacks sorting, filters, search and the buttons of figures, and no figure and no word.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import jinja2
from markupsafe import Markup, escape

from gpusimbench import schemas
from gpusimbench.evaluator.render.document import (
    NONE,
    Beside,
    Block,
    Cell,
    Code,
    Document,
    Embed,
    Facts,
    Figure,
    Gallery,
    Item,
    Items,
    Row,
    Section,
    Table,
    Text,
    Tone,
    walk,
)
from gpusimbench.evaluator.render.figures import palette, style
from gpusimbench.evaluator.render.table_files import to_csv
from gpusimbench.evaluator.render.templating import policy, script
from gpusimbench.schemas.text import printable

LARGEST_CSV = 256_000
"""Characters of a figure's numbers that a page carries; more of them are left to `gsb-eval --figures`."""

FIRST_ROWS = 25
"""Rows that a table shows until a reader asks for all."""

_OPEN_ROWS = 4  # a table of more rows has each on a line, until a reader opens the row
_FIRST_FIGURES = 6
_FIRST_ITEMS = 8
_LONG_CODE, _SHOWN_CODE = 1000, 60  # characters of commands: of longer ones a page shows so many
_SHORT_LEGEND = 2  # lines; of more, a page shows that there are some
_LONG = 48  # characters of a cell that are cut to what its line has room for
_ROOM = 152  # characters of a row on a page of 1280 pixels
_GAP = 2  # characters that a column's edges take
_NAME, _LONGEST_NAME = 48, 90  # characters of the names of rows: what a page has room for, and what is one
_SMALL = 0.85  # width of an interval's character
_TIGHT = "An opened row shows its intervals."
_MARK = re.compile(r"\([a-z]{1,2}\)")

_EMPTY = Markup("")


def render_page(document: Document) -> str:
    """The page's text; the same document gives the same page."""
    embeds = [one for one in walk(document.blocks) if isinstance(one, Embed)]
    has_figures = bool(embeds) or any(isinstance(one, Figure) and one.svg for one in walk(document.blocks))
    names = ["page.js", *(["download.js"] if has_figures else [])]
    scripts = [*map(script, names), *dict.fromkeys(one.script for one in embeds if one.script)]
    templates = jinja2.Environment(
        loader=jinja2.PackageLoader("gpusimbench.evaluator.render"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = templates.get_template("page.html.j2").render(
        title=_text(document.title),
        lead=_text(document.lead),
        body=blocks(document.blocks, 2),
        facets=_facets(document),
        made_by=blocks(document.made_by, 2),
        version=schemas.__version__,
        styles=list(dict.fromkeys(one.style for one in embeds if one.style)),
        colours={
            "light": Markup(palette.variables(dark=False)),
            "dark": Markup(palette.variables(dark=True)),
            "figures": Markup(style.css()) if has_figures else _EMPTY,
        },
        figure_rules=json.dumps(style.resolved()) if has_figures else "",
        scripts=scripts,
        policy=policy(scripts),
    )
    return page.lstrip()


def blocks(of: Iterable[Block], level: int) -> Markup:
    """Some blocks, in order; `level` is that of the headings."""
    return Markup("\n").join(_block(one, level) for one in of)


def _text(text: str) -> Markup:
    """A stranger's text: what it holds is shown, and none of it is markup."""
    return escape(printable(text))


def _block(block: Block, level: int) -> Markup:
    match block:
        case Section():
            return _section(block, level)
        case Table():
            return _table(block, level)
        case Figure():
            return _figure(block)
        case Gallery():
            return _gallery(block)
        case Facts():
            return _facts(block)
        case Text():
            return Markup("<p{}>{}</p>").format(_class(block.tone), _text(block.text))
        case Code():
            return _code(block)
        case Items():
            return _items(block.items)
        case Beside():
            columns = (Markup("<div>\n{}\n</div>").format(blocks(column, level)) for column in block.columns)
            return Markup('<div class="beside">\n{}\n</div>').format(Markup("\n").join(columns))
        case Embed():
            return block.markup


def _code(block: Code) -> Markup:
    """Lines as they are typed: a command that names hundreds of files is closed, and shows how it begins."""
    written = Markup("<pre>{}</pre>").format(Markup("\n").join(map(_text, block.lines)))
    size = sum(map(len, block.lines))
    if size <= _LONG_CODE:
        return written
    begin = Markup("<summary><code>{}\u2026</code> ({} characters)</summary>").format(
        _text(" ".join(block.lines)[:_SHOWN_CODE]), f"{size:,}"
    )
    return Markup("<details class=key>{}{}</details>").format(begin, written)


def _section(block: Section, level: int) -> Markup:
    heading = Markup('<h{level} id="{key}">{title}</h{level}>').format(
        level=min(level, 6), key=block.key, title=_text(block.title)
    )
    summary = Markup("<span>{}</span>").format(_text(block.summary)) if block.summary else _EMPTY
    body = blocks(block.blocks, level + 1)
    if block.folded:
        return Markup("<details{}><summary>{}{}</summary>\n{}\n</details>").format(
            _data(block.facets), heading, summary, body
        )
    below = Markup('<p class="lead">{}</p>').format(_text(block.summary)) if block.summary else _EMPTY
    return Markup('<section{} aria-labelledby="{}">\n{}\n{}{}\n</section>').format(
        _data(block.facets), block.key, heading, below, body
    )


def _table(block: Table, level: int) -> Markup:
    if not block.rows:
        return _EMPTY
    numeric = [
        bool(i) and all(row.cells[i].value is not None or row.cells[i].text == NONE for row in block.rows)
        for i in range(len(block.columns))
    ]
    heads = (
        Markup("<th{} scope=col{}>{}</th>").format(
            Markup(" class=num") if numeric[i] else _EMPTY,
            Markup(' title="{}"').format(_text(column.meaning)) if column.meaning else _EMPTY,
            _text(column.title),
        )
        for i, column in enumerate(block.columns)
    )
    closed = (len(block.rows) > _OPEN_ROWS or any(row.more for row in block.rows)) and not block.compact
    whole, tight = _whole(block) if closed else ([], False)
    rows = [_row(row, numeric, block.compact, closed, tight, level) for row in block.rows]
    bodies = Markup("<tbody>\n{}\n</tbody>").format(Markup("\n").join(rows[:FIRST_ROWS]))
    every = _EMPTY
    if len(rows) > FIRST_ROWS + 1:
        bodies += Markup("<tbody class=rest>\n{}\n</tbody>").format(Markup("\n").join(rows[FIRST_ROWS:]))
        every = Markup("\n<details class=every><summary>Show all {} rows</summary></details>").format(len(rows))
    else:
        bodies = Markup("<tbody>\n{}\n</tbody>").format(Markup("\n").join(rows))
    caption = Markup("<caption>{}</caption>\n").format(_text(block.caption)) if block.caption else _EMPTY
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
        _text(name),
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


def _whole(block: Table) -> tuple[list[int], bool]:
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
        _EMPTY.join(Markup("<li>{}</li>").format(_text(one)) for one in lines)
    )
    if len(lines) <= _SHORT_LEGEND:
        return Markup("\n") + listed
    return Markup("\n<details class=key><summary>How to read this table: {} notes</summary>{}</details>").format(
        len(lines), listed
    )


def _row(row: Row, numeric: Sequence[bool], compact: bool, closed: bool, tight: bool, level: int) -> Markup:
    """A row of a table; where rows are closed, its name opens it, and what it has to say stands in a row below it."""
    opens = bool(row.more) or (closed and any(map(_hides, row.cells)))
    opens |= tight and any(one.range for one in row.cells)
    cells = [_cell(one, i, numeric[i], compact, opens and not i, closed) for i, one in enumerate(row.cells)]
    shown = Markup("<tr{}>{}</tr>").format(_data(row.facets), _EMPTY.join(cells))
    if not row.more:
        return shown
    return shown + Markup("\n<tr class=more><td colspan={}>{}</td></tr>").format(
        len(row.cells), blocks(row.more, level)
    )


def _hides(said: Cell) -> bool:
    """Whether a closed row does not show all of a cell."""
    return len(said.text) > _LONG or not all(map(_MARK.fullmatch, said.notes))


def _cell(said: Cell, index: int, numeric: bool, compact: bool, opens: bool, closed: bool) -> Markup:
    classes = " ".join([*(["num"] if numeric else []), *([] if said.tone is Tone.PLAIN else [said.tone.value])])
    attributes = Markup(' class="{}"').format(classes) if classes else _EMPTY
    if said.value is not None:
        attributes += Markup(' data-v="{}"').format(f"{said.value:.9g}")
    if compact and len(said.lines) > 1:
        attributes += Markup(' title="{}"').format(_text("; ".join(said.lines)))
    name = "th scope=row" if index == 0 else "td"
    shown = _opening(said) if opens else _said(said, closed=closed)
    return Markup("<{}{}>{}</{}>").format(Markup(name), attributes, shown, Markup(name[:2]))


def _opening(said: Cell) -> Markup:
    """The name of a row as what opens it: where the name is a link, that stands with what is opened."""
    plain = _said(replace(said, link="", range="", notes=()), closed=True)
    notes = [Markup("<small>{}</small>").format(_text(one)) for one in said.notes]
    if said.link:
        notes.append(Markup('<small><a href="#{}">go to its section</a></small>').format(said.link))
    return Markup("<details class=row><summary>{}</summary></details>{}").format(plain, _EMPTY.join(notes))


def _said(said: Cell, *, closed: bool = False) -> Markup:
    shown = _text(said.text)
    if said.code:
        shown = Markup("<code>{}</code>").format(shown)
    if said.link:
        shown = Markup('<a href="#{}">{}</a>').format(said.link, shown)
    if closed and len(said.text) > _LONG:
        shown = Markup("<span class=long>{}</span>").format(shown)
    bounds = Markup("<small class=whole>{}</small>").format(_text(said.range)) if said.range else _EMPTY
    notes = (
        Markup("<small{}>{}</small>").format(Markup(" class=mark") if _MARK.fullmatch(one) else _EMPTY, _text(one))
        for one in said.notes
    )
    return shown + bounds + _EMPTY.join(notes)


def _gallery(block: Gallery) -> Markup:
    """Figures in a grid: the first at once, and all others once a reader asks for them."""
    grid = Markup('<div class="figures" data-least="{}">\n{}\n</div>')
    made = [*map(_figure, block.figures)]
    first = len(made) if len(made) <= _FIRST_FIGURES + 1 else _FIRST_FIGURES
    shown = grid.format(f"{block.least:g}", Markup("\n").join(made[:first]))
    if not made[first:]:
        return shown
    rest = grid.format(f"{block.least:g}", Markup("\n").join(made[first:]))
    return shown + Markup("\n<details class=key><summary>Show all {} figures</summary>\n{}\n</details>").format(
        len(made), rest
    )


def _figure(block: Figure) -> Markup:
    drawn, named, files = _EMPTY, _EMPTY, _EMPTY
    if block.svg:
        drawn = Markup('<div class="drawn">{}</div>').format(block.svg)
    if block.svg and block.key:
        named = Markup(' data-file="{}"').format(block.file_name)
        files = _files(block)
    caption = Markup('<p class="caption">{}</p>').format(_text(block.caption)) if block.caption else _EMPTY
    return Markup("<figure{}>\n<figcaption><bdi>{}</bdi></figcaption>\n{}\n{}{}</figure>").format(
        named, _text(block.label), drawn, caption, files
    )


def _files(block: Figure) -> Markup:
    """Buttons that a script brings to life, and the figure's numbers for them."""
    label = _text(block.label)
    csv = to_csv(block.numbers.titles, block.numbers.rows) if block.numbers.titles else ""
    button = Markup('<button type="button" value="{}" aria-label="{} of {}">{}</button>')
    buttons = button.format("svg", "SVG", label, "SVG")
    numbers = _EMPTY
    if 0 < len(csv) <= LARGEST_CSV:
        buttons += Markup(" ") + button.format("csv", "CSV", label, "CSV")
        numbers = Markup("<pre hidden>{}</pre>\n").format(_text(csv.replace("\r\n", "\n")))
    elif csv:
        buttons += Markup(" <small>numbers: too many for a page, see gsb-eval --figures</small>")
    return Markup('<p class="files" hidden>{}</p>\n{}').format(buttons, numbers)


def _facts(block: Facts) -> Markup:
    pairs = Markup("\n").join(
        Markup("<div><dt>{}</dt><dd{}>{}</dd></div>").format(_text(name), _class(said.tone), _said(said))
        for name, said in block.pairs
    )
    return Markup("<dl>\n{}\n</dl>").format(pairs) if block.pairs else _EMPTY


def _items(of: Sequence[Item]) -> Markup:
    """A list: what stands below an item is closed, and so is what follows the first items."""
    if not of:
        return _EMPTY
    made = [_item(one) for one in of]
    first = len(made) if len(made) <= _FIRST_ITEMS + 1 else _FIRST_ITEMS
    shown = Markup("<ul>\n{}\n</ul>").format(Markup("\n").join(made[:first]))
    if not made[first:]:
        return shown
    rest = Markup("\n").join(made[first:])
    return shown + Markup("\n<details class=key><summary>Show all {}</summary><ul>\n{}\n</ul></details>").format(
        len(made), rest
    )


def _item(one: Item) -> Markup:
    shown = _text(one.text)
    if one.link:
        shown = Markup('<a href="#{}">{}</a>').format(one.link, shown)
    if one.items:
        shown = Markup("<details class=key><summary>{}</summary>{}</details>").format(shown, _items(one.items))
    return Markup("<li{}>{}</li>").format(_class(one.tone), shown)


def _class(tone: Tone) -> Markup:
    return _EMPTY if tone is Tone.PLAIN else Markup(' class="{}"').format(tone.value)


def _data(facets: Mapping[str, str]) -> Markup:
    return _EMPTY.join(Markup(' data-{}="{}"').format(name, _text(value)) for name, value in facets.items())


def _facets(document: Document) -> dict[str, list[str]]:
    """What readers can filter by: every facet of a row or a section that has more than one value."""
    found: dict[str, dict[str, None]] = {}
    for block in walk(document.blocks):
        holders = block.rows if isinstance(block, Table) else [block] if isinstance(block, Section) else []
        for holder in holders:
            for name, value in holder.facets.items():
                found.setdefault(name, {}).setdefault(printable(value))
    return {name: sorted(values) for name, values in found.items() if len(values) > 1}
