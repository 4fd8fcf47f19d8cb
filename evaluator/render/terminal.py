"""A document as lines for a terminal or a log: text of strangers moves no cursor and looks like no line of ours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import IO

from rich.cells import cell_len
from rich.console import Console, Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text as RichText

from gpusimbench.evaluator.render.console import Hanging, make_console, plain_table
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
    cell,
)
from gpusimbench.schemas.text import line

_STYLES = {Tone.PLAIN: "", Tone.GOOD: "green", Tone.WARNING: "yellow", Tone.BAD: "bold red", Tone.QUIET: "dim"}
_SIDEWAYS = 22
"""Columns of characters that a row needs where rows stand side by side."""

_HEAD = 32
_GAP = 2
_LEAST = 10
_NAME = 64
"""Characters of a row's name that stand on one line where the name has as many and there is room."""

_WRAPPED = 40
"""Characters to which names are wrapped before other columns are."""

_UNBROKEN = 24
"""Characters of a word that stand on one line: no number has more, and flags of a compiler leave no room to others."""

_MOST_SIDEWAYS = 4
_LONGEST_NAME = 32


def print_document(document: Document, stream: IO[str]) -> None:
    """Print all of it: figures as their captions, folded sections as any other."""
    console = make_console(stream)
    if document.title:
        console.print(line(document.title), style="bold")
    if document.lead:
        console.print(line(document.lead))
    print_blocks(document.blocks, console)
    print_blocks(document.made_by, console)


def print_blocks(blocks: Iterable[Block], console: Console) -> None:
    """Print some blocks, in order."""
    for block in blocks:
        _print(block, console, "")


def _print(block: Block, console: Console, indent: str) -> None:
    match block:
        case Section():
            console.print()
            said = f"{block.title}: {block.summary}" if block.summary else block.title
            console.print(line(said), style="bold")
            for one in block.blocks:
                _print(one, console, indent)
        case Table():
            _print_table(block, console)
            for row in block.rows:
                if row.more:
                    console.print()
                    console.print(line(row.cells[0].text), style="bold")
                for one in row.more:
                    _print(one, console, indent)
        case Facts():
            _print_facts(block, console)
        case Text():
            console.print(f"{indent}{line(block.text)}", style=_STYLES[block.tone])
        case Code():
            for typed in block.lines:
                console.print(f"    {line(typed)}", soft_wrap=True)
        case Items():
            _print_items(block.items, console, indent)
        case Beside():
            for column in block.columns:
                for one in column:
                    _print(one, console, indent)
        case Gallery():
            for figure in block.figures:
                _print(figure, console, indent)
        case Figure():
            # what a figure shows is in a page; what it says where there is nothing to draw is said here too
            if block.svg is None:
                console.print(line(f"{block.title}: {block.caption}"), style="dim")
        case Embed():
            if block.instead:
                console.print(line(block.instead), style="dim")


def _print_items(items: Sequence[Item], console: Console, indent: str) -> None:
    for item in items:
        console.print(f"{indent}{line(item.text)}", style=_STYLES[item.tone])
        _print_items(item.items, console, f"{indent}  ")


def _print_facts(block: Facts, console: Console) -> None:
    width = max((min(_LONGEST_NAME, len(line(name))) for name, _ in block.pairs), default=0)
    for name, said in block.pairs:
        for number, text in enumerate(said.lines):
            head = "" if number else line(name)
            shown = f"  {head:<{width}}  {line(text)}"
            if said.code:  # to be copied
                console.print(shown, style=_STYLES[said.tone], soft_wrap=True)
            else:
                hang = width + 2 if head else 0  # a further line begins with as many blanks
                console.print(Hanging(shown, _STYLES[said.tone], hang=hang), soft_wrap=False)


def _print_table(block: Table, console: Console) -> None:
    if not block.rows:
        return
    if block.caption:
        console.print(line(block.caption), style="bold")
    upright = _rich_table([c.title for c in block.columns], [row.cells for row in block.rows], console.width)
    measured = console.measure(upright, options=console.options.update(width=100_000))
    if measured.maximum <= 2 * console.width and measured.minimum <= console.width:
        console.print(upright)
    else:
        _print_sideways(block, console)
    for one in block.legend:
        console.print(f"  {line(one)}", style="dim")


def _print_sideways(block: Table, console: Console) -> None:
    """Rows side by side, as many at a time as can be read; what is a dash for all of these is left out."""
    at_once = max(1, min(_MOST_SIDEWAYS, (console.width - _HEAD) // _SIDEWAYS))
    for begin in range(0, len(block.rows), at_once):
        rows = block.rows[begin : begin + at_once]
        across = [
            [cell(column.title), *(row.cells[index] for row in rows)]
            for index, column in enumerate(block.columns)
            if index and any(row.cells[index].text != NONE for row in rows)
        ]
        if begin:
            console.print()
        titles = [block.columns[0].title, *(row.cells[0].text for row in rows)]
        console.print(_rich_table(titles, across, console.width))


def _rich_table(titles: Sequence[str], rows: Sequence[Sequence[Cell]], width: int) -> RenderableType:
    made = plain_table(*titles)
    for index, column in enumerate(made.columns):
        numeric = all(row[index].value is not None or row[index].text == NONE for row in rows)
        column.justify = "right" if index and numeric else "left"
    names = [titles[0], *(text for row in rows for text in row[0].lines)]
    made.columns[0].width = max(_LEAST, min(max(map(len, names)), _NAME, width - _needed(titles, rows) - _GAP))
    _keep_words_whole(made, titles, rows, width)
    for row in rows:
        made.add_row(*map(_rich_cell, row))
    return made


def _keep_words_whole(made: RichTable, titles: Sequence[str], rows: Sequence[Sequence[Cell]], width: int) -> None:
    """Set the widths of columns where there is no room for all: rich would break words, and part of a number misleads.

    Each column has room for its longest word, up to _UNBROKEN characters, behind the blanks of a line that goes on;
    columns that need the least more get it first. Where not even that fits, the table is wider than the terminal.
    """
    texts = [[title, *(said for row in rows for said in row[i].lines)] for i, title in enumerate(titles)][1:]
    whole = [max(cell_len(line(text)) for text in column) for column in texts]
    words = [
        max((min(_UNBROKEN, cell_len(line(word))) for text in column for word in text.split()), default=0)
        for column in texts
    ]
    least = [min(all_of, word + _GAP) for all_of, word in zip(whole, words, strict=True)]
    space = width - _GAP * len(titles)
    first = made.columns[0].width or _LEAST
    if first + sum(whole) <= space:
        return
    if space - sum(whole) >= min(first, _WRAPPED):  # a name in two lines reads better than a number in two
        made.columns[0].width = space - sum(whole)
        return
    made.columns[0].width = first = max(_LEAST, min(first, space - sum(least)))
    room = max(0, space - first - sum(least))
    for index in sorted(range(len(texts)), key=lambda i: whole[i] - least[i]):
        more = min(room, whole[index] - least[index])
        made.columns[index + 1].width = least[index] + more
        room -= more


def _needed(titles: Sequence[str], rows: Sequence[Sequence[Cell]]) -> int:
    """Characters that all columns but the first need at least: their longest words, with the gaps between columns."""
    columns = [[title, *(said for row in rows for said in row[i].lines)] for i, title in enumerate(titles) if i]
    return sum(
        _GAP + max((min(_UNBROKEN, len(word)) for text in texts for word in text.split()), default=0)
        for texts in columns
    )


def _rich_cell(said: Cell) -> RenderableType:
    style = _STYLES[said.tone]
    if len(said.lines) == 1:
        return RichText(line(said.text), style=style)
    below = [Hanging(line(one), "dim", hang=2) for one in said.lines[1:]]
    return Group(Hanging(line(said.text), style, hang=2), *below)
