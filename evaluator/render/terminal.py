"""A document as lines for a terminal or a log: text of strangers moves no cursor and looks like no line of ours."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import IO

from rich.cells import cell_len
from rich.console import Console, Group, RenderableType
from rich.text import Text as RichText

from gpusimbench.evaluator.render.console import Hanging, make_console, pieces, plain_table
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
_LEAST_OF_NAMES = 20
"""Characters of names, where they have as many: with less room, rows stand side by side."""

_NAME = 64
"""Characters of a row's name that stand on one line where the name has as many and there is room."""

_UNBROKEN = 24
"""Characters of a word that stand on one line: no number has more, and flags of a compiler leave no room to others."""

_MOST_SIDEWAYS = 4

_Sizes = tuple[tuple[int, ...], ...]
"""Lengths of the words of each text of a cell."""
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
    for index, of_column in enumerate(_widths(titles, rows, width - _GAP * len(titles))):
        made.columns[index].width = of_column
    for row in rows:
        made.add_row(*map(_rich_cell, row))
    return made


def _widths(titles: Sequence[str], rows: Sequence[Sequence[Cell]], space: int) -> list[int]:
    """The widths of columns in a space: rich would break words, and part of a number misleads.

    Each column has room for its longest word, up to _UNBROKEN characters, behind the blanks of a line that goes on.
    Names have room for more, and may be broken behind a hyphen. What is left goes, again and again, to the column in
    which a character makes most of a difference. Where not even the longest words fit, the table is wider than the
    space.
    """
    columns = [
        Counter([_sizes([title]), *(_sizes(row[index].lines) for row in rows)]) for index, title in enumerate(titles)
    ]
    whole = [max(sum(words) + len(words) - 1 for cell in of for words in cell) for of in columns]
    whole[0] = min(whole[0], _NAME)
    words = [_longest(titles[index], [row[index] for row in rows], joints=not index) for index in range(len(titles))]
    widths = [min(all_of, word + _GAP) for all_of, word in zip(whole, words, strict=True)]
    widths[0] = max(_LEAST, min(whole[0], max(_LEAST_OF_NAMES, widths[0])))
    gains = [_gain(of, width, space) for of, width in zip(columns, widths, strict=True)]
    while possible := [
        (gain, more, index) for index, (gain, more) in enumerate(gains) if gain and more <= space - sum(widths)
    ]:
        _, more, index = max(possible)
        widths[index] += more
        gains[index] = _gain(columns[index], widths[index], space)
    return widths


def _sizes(texts: Iterable[str]) -> _Sizes:
    return tuple(tuple(map(cell_len, line(text).split(" "))) for text in texts)


def _longest(title: str, cells: Sequence[Cell], *, joints: bool) -> int:
    """Characters of the longest word of a column, or of what stands between the joints of its words."""
    found = (word for text in (title, *(said for one in cells for said in one.lines)) for word in line(text).split())
    parts = (part for word in found for part in (pieces(word) if joints else [word]))
    return max((min(_UNBROKEN, cell_len(part)) for part in parts), default=0)


def _gain(cells: Counter[_Sizes], width: int, most: int) -> tuple[float, int]:
    """What a column gains by each of the characters that it needs to have fewer lines, and their number; no gain where
    `most` characters are too few for that.

    cells  how many have texts of words of such lengths
    """
    now = _cost(cells, width)
    if most < 1 or _cost(cells, width + most) == now:
        return 0.0, 0
    more = 1 + bisect_left(range(1, most + 1), True, key=lambda more: _cost(cells, width + more) < now)
    return (now - _cost(cells, width + more)) / more, more


def _cost(cells: Counter[_Sizes], width: int) -> int:
    """The sum of squared numbers of lines: the tallest cell of a row decides on its height."""
    return sum(times * sum(_lines(words, width) for words in cell) ** 2 for cell, times in cells.items())


def _lines(words: Sequence[int], width: int) -> int:
    """Lines of a text; those of a text that goes on are shorter."""
    if sum(words) + len(words) - 1 <= width:
        return 1
    width, count, filled = max(1, width - _GAP), 1, -1
    for word in words:
        if filled + 1 + word <= width:
            filled += 1 + word
        else:
            count += 1 if filled >= 0 else 0
            count += max(0, -(-word // width) - 1)
            filled = (word - 1) % width + 1 if word else 0
    return count


def _rich_cell(said: Cell) -> RenderableType:
    style = _STYLES[said.tone]
    if len(said.lines) == 1:
        return RichText(line(said.text), style=style)
    below = [Hanging(line(one), "dim", hang=2) for one in said.lines[1:]]
    return Group(Hanging(line(said.text), style, hang=2), *below)
