"""A document as one HTML page that needs nothing but itself: no network, no other file.

Every text is a stranger's and is escaped here. The page's policy allows its own scripts by their digests and nothing
else; without scripts the page lacks sorting, filters, search and the buttons of figures, and no figure and no word.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

import jinja2
from markupsafe import Markup, escape

from gpusimbench import schemas
from gpusimbench.evaluator.render.csv import to_csv
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
    Section,
    Table,
    Text,
    Tone,
    walk,
)
from gpusimbench.evaluator.render.figures import palette, style
from gpusimbench.evaluator.render.scripts import policy, script
from gpusimbench.schemas.text import printable

LARGEST_CSV = 256_000
"""Characters of a figure's numbers that a page carries; more of them are left to `gsb-eval --figures`."""

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
            return _table(block)
        case Figure():
            return _figure(block)
        case Gallery():
            made = Markup("\n").join(map(_figure, block.figures))
            return Markup('<div class="figures" data-least="{}">\n{}\n</div>').format(f"{block.least:g}", made)
        case Facts():
            return _facts(block)
        case Text():
            return Markup("<p{}>{}</p>").format(_class(block.tone), _text(block.text))
        case Code():
            return Markup("<pre>{}</pre>").format(Markup("\n").join(map(_text, block.lines)))
        case Items():
            return _items(block.items)
        case Beside():
            columns = (Markup("<div>\n{}\n</div>").format(blocks(column, level)) for column in block.columns)
            return Markup('<div class="beside">\n{}\n</div>').format(Markup("\n").join(columns))
        case Embed():
            return block.markup


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


def _table(block: Table) -> Markup:
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
    rows = (
        Markup("<tr{}>{}</tr>").format(
            _data(row.facets), _EMPTY.join(_cell(one, i, numeric[i], block.compact) for i, one in enumerate(row.cells))
        )
        for row in block.rows
    )
    caption = Markup("<caption>{}</caption>\n").format(_text(block.caption)) if block.caption else _EMPTY
    legend = _EMPTY
    if block.legend:
        lines = _EMPTY.join(Markup("<li>{}</li>").format(_text(one)) for one in block.legend)
        legend = Markup('\n<ul class="legend">{}</ul>').format(lines)
    name = block.caption or block.key.replace("-", " ")
    return Markup(
        '<div class="table{}" role="region" tabindex="0" aria-label="{}"><table>\n{}<thead><tr>{}</tr></thead>\n'
        "<tbody>\n{}\n</tbody></table></div>{}"
    ).format(
        Markup(" compact") if block.compact else _EMPTY,
        _text(name),
        caption,
        _EMPTY.join(heads),
        Markup("\n").join(rows),
        legend,
    )


def _cell(said: Cell, index: int, numeric: bool, compact: bool) -> Markup:
    classes = " ".join([*(["num"] if numeric else []), *([] if said.tone is Tone.PLAIN else [said.tone.value])])
    attributes = Markup(' class="{}"').format(classes) if classes else _EMPTY
    if said.value is not None:
        attributes += Markup(' data-v="{}"').format(f"{said.value:.9g}")
    if compact and len(said.lines) > 1:
        attributes += Markup(' title="{}"').format(_text("; ".join(said.lines)))
    name = "th scope=row" if index == 0 else "td"
    return Markup("<{}{}>{}</{}>").format(Markup(name), attributes, _said(said), Markup(name[:2]))


def _said(said: Cell) -> Markup:
    shown = _text(said.text)
    if said.code:
        shown = Markup("<code>{}</code>").format(shown)
    if said.link:
        shown = Markup('<a href="#{}">{}</a>').format(said.link, shown)
    bounds = Markup("<small class=whole>{}</small>").format(_text(said.range)) if said.range else _EMPTY
    notes = _EMPTY.join(Markup("<small>{}</small>").format(_text(one)) for one in said.notes)
    return shown + bounds + notes


def _figure(block: Figure) -> Markup:
    drawn, named, files = block.svg or _EMPTY, _EMPTY, _EMPTY
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
    if not of:
        return _EMPTY
    made = Markup("\n").join(
        Markup("<li{}>{}{}</li>").format(
            _class(one.tone),
            Markup('<a href="#{}">{}</a>').format(one.link, _text(one.text)) if one.link else _text(one.text),
            _items(one.items),
        )
        for one in of
    )
    return Markup("<ul>\n{}\n</ul>").format(made)


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
