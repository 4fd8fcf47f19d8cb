"""Tables of numbers that stay whole, however narrow a terminal is."""

from __future__ import annotations

from collections.abc import Sequence

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.render.console import plain_table
from gpusimbench.schemas.text import printable

_GAP = 2  # columns of a terminal between those of a table
_NAME = 5  # of them for names, at least


def print_numbers(console: Console, titles: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows of a name and numbers.

    Where there is no room, titles are broken between words and names anywhere, and numbers never: a part of one reads
    as another one. A terminal that is narrower still breaks the lines.
    """
    shown = [[printable(cell) for cell in row] for row in rows]
    table = plain_table(*titles)
    for row in shown:
        table.add_row(*(Text(cell) for cell in row))
    cells = [max((cell_len(row[index]) for row in shown), default=0) for index in range(len(titles))]
    natural = [max(cell, cell_len(title)) for cell, title in zip(cells, titles, strict=True)]
    gaps = _GAP * (len(titles) - 1)
    if sum(natural) + gaps > console.width:
        widths = [
            max(cell, *(cell_len(word) for word in title.split()))
            for title, cell in zip(titles[1:], cells[1:], strict=True)
        ]
        for column, width in zip(table.columns[1:], widths, strict=True):
            column.width = width
        needed = min(cells[0], _NAME) + sum(widths) + gaps
        table.width = needed if needed > console.width else None
    console.print(table, crop=False)
