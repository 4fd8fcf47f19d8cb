"""A document as Markdown for GitHub, GitLab and pandoc: no text of a stranger is markup, a mention or a link.

A character is escaped only where Markdown would interpret it, so that a person can read the text. CommonMark and the
extensions of GitHub, GitLab and pandoc are held off: emphasis, links, tables, HTML, mathematics, mentions and
addresses. Words, numbers, versions, file names and units stay as they are.
"""

from __future__ import annotations

import re
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

_APART = "\u200b"  # mentions and issues are looked for in what was rendered, so a space of no width parts them
_BACKSLASHED = frozenset("`*_[#+-.)>~")  # what a reader of the source knows behind a backslash; others are references

_PATTERN = r"""
  (?P<mention> @(?=[\w{]) | [\#!](?=\d) | \bGH-(?=\d) )
| (?P<emphasis> \*+ | _+ )
| \A (?: [-+](?=\ |\Z) | -(?=[-\ ]*\Z) | \d{1,9}[.)](?=\ |\Z) )     # a list or a rule
| \A (?: \#(?=\#*(?:\ |\Z)) | =(?==*\Z) ) | (?<=\ )\#(?=\#*\Z)      # a heading, and its end
| \A (?: > | \[(?=[\ X]\](?:\ |\Z)) | [:%~](?=\ |\Z) )             # a quotation, a task, a definition, a title
| [`\\|$] | ~(?=[^\ ]) | \^(?=[^\ ^]+\^)                            # code, a cell, mathematics, struck out, raised
| \[(?!(?!\^)[\w\ /%.,+=^·°-]*\](?![(\[{:]))                       # a link; `[cm]` is none
| <(?=[A-Za-z/!?]|\Z) | &(?=\#[0-9Xx]|[A-Za-z][A-Za-z0-9]*;)
| \{(?=[\w\#.%{=-])                                                # attributes, and what templates replace
| (?:(?<=http)|(?<=https)|(?<=ftp)):(?=//) | (?<![^\W_])www\.
"""
_MARKUP = re.compile(_PATTERN, re.VERBOSE | re.IGNORECASE)
_MARKUP_OR_HTML = re.compile(rf"{_PATTERN}| [<&]", re.VERBOSE | re.IGNORECASE)


def prose(text: str, *, html: bool = False) -> str:
    """Text of strangers on one line, for a paragraph, a heading, an item or a cell: no markup, mention or link.

    What moves or hides text becomes visible.

    html  for the inside of an element of HTML, where CommonMark knows no backslash and pandoc knows everything
    """
    shown = line(re.sub(r"[\t\n\r]", " ", text).strip(" "))

    def escaped(found: re.Match[str]) -> str:
        matched, before, behind = found[0], shown[: found.start()][-1:], shown[found.end() :][:1]
        if found["mention"]:
            return f"{matched}{_APART}"
        if found["emphasis"]:
            literal = before == behind == " " or (matched[0] == "_" and before.isalnum() and behind.isalnum())
            return matched if literal else "".join(_escape(one, html) for one in matched)
        return f"{matched[:-1]}{_escape(matched[-1], html)}"

    return (_MARKUP_OR_HTML if html else _MARKUP).sub(escaped, shown)


def code(text: str, *, cell: bool = False) -> str:
    """Text of strangers in a fixed font, in which nothing is markup; `cell` is for a table's."""
    shown = line(text).replace("|", "\\|") if cell else line(text)
    ticks = "`" * (_longest_run(shown) + 1)
    room = " " if shown[:1] in ("`", " ") or shown[-1:] == "`" else ""
    return f"{ticks}{room}{shown}{room}{ticks}" if shown else ""


def fenced(lines: tuple[str, ...]) -> list[str]:
    """Lines of code as they are: nothing is markup between fences, and no line has as many backticks as these."""
    shown = [line(one) for one in lines]
    fence = "`" * max(3, max(map(_longest_run, shown), default=0) + 1)
    return [fence, *shown, fence]


def _longest_run(text: str) -> int:
    return max(map(len, re.findall("`+", text)), default=0)


def _escape(character: str, html: bool) -> str:
    if character in _BACKSLASHED and not html:
        return f"\\{character}"
    return {"<": "&lt;", "&": "&amp;"}.get(character) or f"&#{ord(character)};"


def render_markdown(document: Document) -> str:
    """The whole document; folded sections are `<details>`, figures are left out."""
    lines = [f"# {prose(document.title)}", ""] if document.title else []
    if document.lead:
        lines += [prose(document.lead), ""]
    return "\n".join([*lines, *blocks((*document.blocks, *document.made_by))]).rstrip("\n") + "\n"


def blocks(of: Iterable[Block], level: int = 2) -> Iterator[str]:
    """Lines of some blocks, an empty one behind each block; `level` is that of the headings."""
    for one in of:
        yield from _block(one, level)


def table_markdown(block: Table) -> str:
    """A table alone, its caption and legend below."""
    return "\n".join(_table(block))


def _block(block: Block, level: int) -> Iterator[str]:
    match block:
        case Section():
            yield from _section(block, level)
        case Table():
            yield from _table(block)
            for row in block.rows:
                if row.more:
                    yield from _section(Section("", row.cells[0].text, row.more, folded=True), level)
        case Facts():
            yield from (f"- {prose(f'{name}:')} {_cell(said)}" for name, said in block.pairs)
            yield ""
        case Text():
            yield from (_toned(prose(block.text), block.tone), "")
        case Code():
            yield from (*fenced(block.lines), "")
        case Items():
            yield from (*_items(block.items, ""), "")
        case Beside():
            for column in block.columns:
                yield from blocks(column, level)
        case Figure():
            if block.svg is None:
                yield from (prose(f"{block.title}: {block.caption}"), "")
        case Gallery():
            yield from blocks(block.figures, level)
        case Embed():
            yield from (prose(block.instead), "") if block.instead else ()


def _section(block: Section, level: int) -> Iterator[str]:
    title = f"{block.title}: {block.summary}" if block.summary else block.title
    if block.folded:
        yield from (f"<details><summary>{prose(title, html=True)}</summary>", "")
        yield from blocks(block.blocks, level + 1)
        yield from ("</details>", "")
    else:
        yield from (f"{'#' * min(level, 6)} {prose(title)}", "")
        yield from blocks(block.blocks, level + 1)


def _table(block: Table) -> Iterator[str]:
    if not block.rows:
        return
    numeric = [all(row.cells[i].value is not None for row in block.rows) for i in range(len(block.columns))]
    yield _row(prose(column.title) for column in block.columns)
    yield _row("---:" if right and i else "---" for i, right in enumerate(numeric))
    yield from (_row(_cell(cell, in_table=True) for cell in row.cells) for row in block.rows)
    yield ""
    if block.caption:
        yield from (f"Table: {prose(block.caption)}", "")
    if block.legend:
        yield from (*(f"- {prose(one)}" for one in block.legend), "")


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(said: Cell, *, in_table: bool = False) -> str:
    if said.text == NONE and not said.notes:
        return NONE
    shown = code(said.text, cell=in_table) if said.code else prose(said.text)
    below = [prose(one) for one in said.lines[1:]]
    return "<br>".join([_toned(shown, said.tone), *below])


def _items(of: Sequence[Item], indent: str) -> Iterator[str]:
    for one in of:
        yield f"{indent}- {_toned(prose(one.text), one.tone)}"
        yield from _items(one.items, f"{indent}  ")


def _toned(shown: str, tone: Tone) -> str:
    return f"<b>{shown}</b>" if tone is Tone.BAD else shown  # stars need no space beside them
