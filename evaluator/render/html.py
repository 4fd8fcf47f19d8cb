"""A document as one HTML page that needs nothing but itself: no network, no other file.

Every text is a stranger's and is escaped here. The page's policy allows its own scripts by their digests and nothing
else; without scripts the page lacks sorting, filters, search and the buttons of figures, and no figure and no word.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from functools import partial

import jinja2
from markupsafe import Markup

from gpusimbench import schemas
from gpusimbench.evaluator.render.document import (
    Beside,
    Block,
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
from gpusimbench.evaluator.render.html_table import cell_content, data_attributes, table_markup
from gpusimbench.evaluator.render.table_files import to_csv
from gpusimbench.evaluator.render.templating import escaped, page_templates, policy, script
from gpusimbench.schemas.text import printable

LARGEST_CSV = 256_000
"""Characters of a figure's numbers that a page carries; more of them are left to `gsb-eval --figures`."""

_FIRST_FIGURES = 6
_FIRST_ITEMS = 8
_LONG_CODE, _SHOWN_CODE = 1000, 60  # characters of commands: of longer ones a page shows so many

_EMPTY = Markup("")


def render_page(document: Document) -> str:
    """The page's text; the same document gives the same page."""
    embeds = [one for one in walk(document.blocks) if isinstance(one, Embed)]
    has_figures = bool(embeds) or any(isinstance(one, Figure) and one.svg for one in walk(document.blocks))
    names = ["page.js", *(["download.js"] if has_figures else [])]
    scripts = [*map(script, names), *dict.fromkeys(one.script for one in embeds if one.script)]
    templates = page_templates(jinja2.PackageLoader("gpusimbench.evaluator.render"))
    page = templates.get_template("page.html.j2").render(
        title=escaped(document.title),
        lead=escaped(document.lead),
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


def _block(block: Block, level: int) -> Markup:
    match block:
        case Section():
            return _section(block, level)
        case Table():
            return table_markup(block, partial(blocks, level=level))
        case Figure():
            return _figure(block)
        case Gallery():
            return _gallery(block)
        case Facts():
            return _facts(block)
        case Text():
            return Markup("<p{}>{}</p>").format(_class(block.tone), escaped(block.text))
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
    written = Markup("<pre>{}</pre>").format(Markup("\n").join(map(escaped, block.lines)))
    size = sum(map(len, block.lines))
    if size <= _LONG_CODE:
        return written
    begin = Markup("<summary><code>{}\u2026</code> ({} characters)</summary>").format(
        escaped(" ".join(block.lines)[:_SHOWN_CODE]), f"{size:,}"
    )
    return Markup("<details class=key>{}{}</details>").format(begin, written)


def _section(block: Section, level: int) -> Markup:
    heading = Markup('<h{level} id="{key}">{title}</h{level}>').format(
        level=min(level, 6), key=block.key, title=escaped(block.title)
    )
    summary = Markup("<span>{}</span>").format(escaped(block.summary)) if block.summary else _EMPTY
    body = blocks(block.blocks, level + 1)
    if block.folded:
        return Markup("<details{}><summary>{}{}</summary>\n{}\n</details>").format(
            data_attributes(block.facets), heading, summary, body
        )
    below = Markup('<p class="lead">{}</p>').format(escaped(block.summary)) if block.summary else _EMPTY
    return Markup('<section{} aria-labelledby="{}">\n{}\n{}{}\n</section>').format(
        data_attributes(block.facets), block.key, heading, below, body
    )


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
    caption = Markup('<p class="caption">{}</p>').format(escaped(block.caption)) if block.caption else _EMPTY
    return Markup("<figure{}>\n<figcaption><bdi>{}</bdi></figcaption>\n{}\n{}{}</figure>").format(
        named, escaped(block.label), drawn, caption, files
    )


def _files(block: Figure) -> Markup:
    """Buttons that a script brings to life, and the figure's numbers for them."""
    label = escaped(block.label)
    csv = to_csv(block.numbers.titles, block.numbers.rows) if block.numbers.titles else ""
    button = Markup('<button type="button" value="{}" aria-label="{} of {}">{}</button>')
    buttons = button.format("svg", "SVG", label, "SVG")
    numbers = _EMPTY
    if 0 < len(csv) <= LARGEST_CSV:
        buttons += Markup(" ") + button.format("csv", "CSV", label, "CSV")
        numbers = Markup("<pre hidden>{}</pre>\n").format(escaped(csv.replace("\r\n", "\n")))
    elif csv:
        buttons += Markup(" <small>numbers: too many for a page, see gsb-eval --figures</small>")
    return Markup('<p class="files" hidden>{}</p>\n{}').format(buttons, numbers)


def _facts(block: Facts) -> Markup:
    pairs = Markup("\n").join(
        Markup("<div><dt>{}</dt><dd{}>{}</dd></div>").format(escaped(name), _class(said.tone), cell_content(said))
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
    shown = escaped(one.text)
    if one.link:
        shown = Markup('<a href="#{}">{}</a>').format(one.link, shown)
    if one.items:
        shown = Markup("<details class=key><summary>{}</summary>{}</details>").format(shown, _items(one.items))
    return Markup("<li{}>{}</li>").format(_class(one.tone), shown)


def _class(tone: Tone) -> Markup:
    return _EMPTY if tone is Tone.PLAIN else Markup(' class="{}"').format(tone.value)


def _facets(document: Document) -> dict[str, list[str]]:
    """What readers can filter by: every facet of a row or a section that has more than one value."""
    found: dict[str, dict[str, None]] = {}
    for block in walk(document.blocks):
        holders = block.rows if isinstance(block, Table) else [block] if isinstance(block, Section) else []
        for holder in holders:
            for name, value in holder.facets.items():
                found.setdefault(name, {}).setdefault(printable(value))
    return {name: sorted(values) for name, values in found.items() if len(values) > 1}
