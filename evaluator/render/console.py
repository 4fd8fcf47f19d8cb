"""Where tables are printed, and how they look: whatever is printed here is made of lines (see schemas.text)."""

from __future__ import annotations

import re
from typing import IO, Any

from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from gpusimbench.schemas.text import line

_WIDTH_WITHOUT_TERMINAL = 120
_JOINTS = re.compile(r"(?<=[-_=/:;.,])(?=[^-_=/:;.,])")  # in numbers such as 1e-08 too, if a number fills a line
_HANG = 4  # blanks before what a line goes on with: nothing that it says can look like another line


class Hanging:
    """A line, broken where there is no room, with blanks before each part but the first."""

    def __init__(self, text: str | Text, style: str = "", hang: int = _HANG) -> None:
        plain = text.plain if isinstance(text, Text) else text
        self._text = Text(line(plain), style=text.style if isinstance(text, Text) else style)
        self._hang = hang + len(plain) - len(plain.lstrip(" "))

    def __rich_console__(self, console: Any, options: Any) -> Any:
        """The parts, as rich wants them."""
        width, how = options.max_width, {"justify": options.justify, "overflow": options.overflow or "fold"}
        parts = _broken(self._text, width).wrap(console, width, **how)
        hang = min(self._hang, width - 1)
        if len(parts) > 1 and hang > 0:
            plain = _broken(self._text, width).wrap(console, width, overflow=how["overflow"])[0].plain.rstrip()
            rest = self._text[len(plain) :]
            rest = rest[len(rest) - len(rest.plain.lstrip()) :]  # the hang is taken from the other parts alone
            parts = [parts[0], *_broken(rest, width - hang).wrap(console, width - hang, **how)]
            for part in parts[1:]:
                part.pad_left(hang)
        for part in parts:
            part.rstrip()
        yield Text("\n").join(parts)

    def __rich_measure__(self, console: Any, options: Any) -> Any:
        """How much room it takes."""
        return Measurement.get(console, options, self._text)


def pieces(word: str) -> list[str]:
    """Parts of a word behind which it may be broken if it is too long for a line: hyphens and the like."""
    return [part for part in _JOINTS.split(word) if part]


def _broken(text: Text, width: int) -> Text:
    """The text with line breaks in words that are longer than a line, behind hyphens and the like."""
    ends, at = [], 0
    for word in re.split(r"( +)", text.plain):
        if cell_len(word) > width:
            filled = 0
            for piece in pieces(word):
                if filled and filled + cell_len(piece) > width:
                    ends.append(at)
                    filled = 0
                filled += cell_len(piece)
                at += len(piece)
        else:
            at += len(word)
    if not ends:
        return text
    return Text("\n").join(text.divide(ends))


class Screen(Console):  # type: ignore[misc]  # rich is not typed for us
    """A console that prints text as lines, whatever is in it."""

    def print(self, *objects: Any, style: str | None = None, **how: Any) -> None:
        """See Console.print; a text is one line."""
        shown = [_shown(one, style or "") for one in objects]
        super().print(*shown, style=style, **how)


def _shown(one: Any, style: str) -> Any:
    if isinstance(one, (str, Text)):
        return Hanging(one, style)
    return _Trimmed(one) if isinstance(one, Table) else one


class _Trimmed:
    """A table without the blanks that rich puts behind each line of it."""

    def __init__(self, table: Table) -> None:
        self._table = table

    def __rich_console__(self, console: Any, options: Any) -> Any:
        """The lines, as rich wants them."""
        for segments in console.render_lines(self._table, options, pad=False):
            while segments and not segments[-1].text.strip():
                segments.pop()
            if segments:
                text, *other = segments.pop()
                segments.append(Segment(text.rstrip(), *other))
            yield from segments
            yield Segment.line()


class PlainTable(Table):  # type: ignore[misc]
    """A table whose cells are lines."""

    def add_column(self, header: Any = "", *arguments: Any, **how: Any) -> None:
        """See Table.add_column."""
        super().add_column(_cell(header), *arguments, **how)

    def add_row(self, *cells: Any, **how: Any) -> None:
        """See Table.add_row."""
        super().add_row(*map(_cell, cells), **how)


def _cell(cell: Any) -> Any:
    return Hanging(cell, hang=2) if isinstance(cell, (str, Text)) else cell


def make_console(stream: IO[str]) -> Screen:
    """A console that prints text as it is, in colour on a terminal alone; elsewhere of a fixed width."""
    console = Screen(file=stream, highlight=False, markup=False, emoji=False)
    if console.is_terminal:
        return console
    return Screen(
        file=stream,
        highlight=False,
        markup=False,
        emoji=False,
        width=_WIDTH_WITHOUT_TERMINAL,
        color_system=None,
    )


def plain_table(*titles: str) -> PlainTable:
    """A table without rules; the first column to the left, the others to the right."""
    table = PlainTable(show_edge=False, pad_edge=False, box=None, header_style="bold")
    for index, title in enumerate(titles):
        table.add_column(title, overflow="fold", justify="right" if index else "left")
    return table
