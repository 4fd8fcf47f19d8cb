"""A document as Markdown for GitHub, GitLab and pandoc: no text of a stranger is markup, a mention or a link."""

from __future__ import annotations

import re
import string
import sys
from collections.abc import Iterable, Iterator, Sequence

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
)
from gpusimbench.schemas.text import line

LONGEST = 300
"""Characters of a text in a comment on a pull request, which may have 65,536 in all."""

_ADDRESS = re.compile(r"(?<=[A-Za-z])\.(?=\S)")
_ISSUE = re.compile(r"(?i)(?<=\bGH-)(?=\d)")
_PLAIN = ".,-()/;%'\"?"  # punctuation that is no structure where it cannot begin a line


def render_markdown(document: Document) -> str:
    """The whole document; folded sections are `<details>`, figures are left out."""
    lines = [f"# {_text(document.title)}", ""] if document.title else []
    if document.lead:
        lines += [_text(document.lead), ""]
    return "\n".join([*lines, *blocks((*document.blocks, *document.made_by))]).rstrip("\n") + "\n"


def blocks(of: Iterable[Block], level: int = 2) -> Iterator[str]:
    """Lines of some blocks, an empty one behind each block; `level` is that of the headings."""
    for one in of:
        yield from _block(one, level)


def table_markdown(block: Table) -> str:
    """A table alone, its caption and legend below."""
    return "\n".join(_table(block))


def safe(text: str, longest: int = LONGEST) -> str:
    """Text of strangers, in which nothing is markup, a mention or a link, on one line.

    Every character that Markdown or HTML knows becomes a character reference, which is never structure; what moves or
    hides text becomes visible. A text of more characters than `longest` is cut.
    """
    shown = text if len(text) <= longest else f"{text[: longest - 3]}..."
    # a point behind a letter may be part of an address, others are of numbers and sentences
    return _ISSUE.sub("\u200b", _ADDRESS.sub("&#46;", "".join(map(_safe, shown))))


def code(text: str) -> str:
    """The same in a fixed font, where no mention or link is looked for."""
    return f"<code>{safe(text)}</code>"


def _safe(character: str) -> str:
    if character in "\t\n\r":
        return " "
    if (shown := line(character)) != character:
        return f"&#92;{shown[1:]}"
    if character in string.punctuation and character not in _PLAIN:
        # a mention or an address is looked for in what was rendered, so a space of no width parts them
        return f"&#{ord(character)};" + ("\u200b" if character in "@#" else "")
    return character


def _text(text: str) -> str:
    return safe(text, sys.maxsize)


def _code(text: str) -> str:
    return f"<code>{_text(text)}</code>"


def _block(block: Block, level: int) -> Iterator[str]:
    match block:
        case Section():
            yield from _section(block, level)
        case Table():
            yield from _table(block)
        case Facts():
            yield from (f"- {_text(name)}: {_cell(said)}" for name, said in block.pairs)
            yield ""
        case Text():
            yield from (_toned(_text(block.text), block.tone), "")
        case Code():
            yield from (*(f"{_code(one)}<br>" for one in block.lines), "")
        case Items():
            yield from (*_items(block.items, ""), "")
        case Beside():
            for column in block.columns:
                yield from blocks(column, level)
        case Figure():
            if block.svg is None:
                yield from (_text(f"{block.title}: {block.caption}"), "")
        case Gallery():
            yield from blocks(block.figures, level)
        case Embed():
            yield from (_text(block.instead), "") if block.instead else ()


def _section(block: Section, level: int) -> Iterator[str]:
    said = f": {_text(block.summary)}" if block.summary else ""
    if block.folded:
        yield from (f"<details><summary>{_text(block.title)}{said}</summary>", "")
        yield from blocks(block.blocks, level + 1)
        yield from ("</details>", "")
    else:
        yield from (f"{'#' * min(level, 6)} {_text(block.title)}{said}", "")
        yield from blocks(block.blocks, level + 1)


def _table(block: Table) -> Iterator[str]:
    if not block.rows:
        return
    numeric = [all(row.cells[i].value is not None for row in block.rows) for i in range(len(block.columns))]
    yield _row(_text(column.title) for column in block.columns)
    yield _row("---:" if right and i else "---" for i, right in enumerate(numeric))
    yield from (_row(map(_cell, row.cells)) for row in block.rows)
    yield ""
    if block.caption:
        yield from (f"Table: {_text(block.caption)}", "")
    if block.legend:
        yield from (*(f"- {_text(one)}" for one in block.legend), "")


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(said: Cell) -> str:
    if said.text == NONE and not said.notes:
        return NONE
    shown = _code(said.text) if said.code else _text(said.text)
    below = [_text(one) for one in said.lines[1:]]
    return "<br>".join([_toned(shown, said.tone), *below])


def _items(of: Sequence[Item], indent: str) -> Iterator[str]:
    for one in of:
        yield f"{indent}- {_toned(_text(one.text), one.tone)}"
        yield from _items(one.items, f"{indent}  ")


def _toned(shown: str, tone: Tone) -> str:
    return f"<b>{shown}</b>" if tone is Tone.BAD else shown  # stars need no space beside them
