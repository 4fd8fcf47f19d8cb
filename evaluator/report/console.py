"""Where tables are printed, and how they look."""

from __future__ import annotations

from typing import IO

from rich.console import Console
from rich.table import Table

_WIDTH_WITHOUT_TERMINAL = 120


def make_console(stream: IO[str], *, columns: int = 0) -> Console:
    """A console that prints text as it is, in colour on a terminal alone; elsewhere as wide as `columns` need."""
    console = Console(file=stream, highlight=False, markup=False, emoji=False)
    if console.is_terminal:
        return console
    return Console(
        file=stream,
        highlight=False,
        markup=False,
        emoji=False,
        width=max(_WIDTH_WITHOUT_TERMINAL, 30 * (columns + 1)),
        color_system=None,
    )


def plain_table(*titles: str) -> Table:
    """A table without rules; the first column to the left, the others to the right."""
    table = Table(show_edge=False, pad_edge=False, box=None, header_style="bold")
    for index, title in enumerate(titles):
        table.add_column(title, overflow="fold", justify="right" if index else "left")
    return table
