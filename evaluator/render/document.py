"""A document: what a command has to say, without a format. Renderers make text, HTML, Markdown, LaTeX or CSV of it.

Every text of a document may be a stranger's: nothing here is markup, and nothing is escaped. Only renderers escape. The
one exception is the drawing of a figure, which the modules of `render.figures` escape themselves.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from markupsafe import Markup

NONE = "-"
"""What a cell says where there is no value."""

_LONGEST_KEY = 80


class Tone(StrEnum):
    """What a text means for its reader. Renderers colour it; the words say the same without a colour."""

    PLAIN = "plain"
    GOOD = "good"
    WARNING = "warning"
    BAD = "bad"
    QUIET = "quiet"


@dataclass(frozen=True)
class Cell:
    """A text, and what is known of it.

    text   what people read
    value  the number behind it, in the unit of its column: tables sort by it, CSV has it in full
    ci95   95 % interval of the value, same unit
    range  the interval as people read it; empty where there is none
    notes  what stands below it, a line each
    tone   what it means
    code   whether it is a command, a name of a file or a hash
    link   key of the section of the same document that says more; empty where there is none
    """

    text: str
    value: float | None = None
    ci95: tuple[float, float] | None = None
    range: str = ""
    notes: tuple[str, ...] = ()
    tone: Tone = Tone.PLAIN
    code: bool = False
    link: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """The text, its interval, its notes: those that are not empty."""
        return tuple(one for one in (self.text, self.range, *self.notes) if one)


EMPTY = Cell(NONE, tone=Tone.QUIET)
"""A cell without a value and without a reason."""


def cell(content: Cell | str) -> Cell:
    """A text as a cell; a cell is left as it is."""
    return content if isinstance(content, Cell) else EMPTY if content in ("", NONE) else Cell(content)


@dataclass(frozen=True)
class Column:
    """A column of a table.

    title    with its unit
    meaning  what it says, for a reader who points at the title or reads the legend
    place    whether it says where a row belongs, as its name does, and nothing of what came out
    """

    title: str
    meaning: str = ""
    place: bool = False


@dataclass(frozen=True)
class Row:
    """A row of a table; the first cell names it.

    facets  by which readers filter, such as simulator, scene, device and level: name to value
    more    what a page shows below the row once a reader opens it
    """

    cells: tuple[Cell, ...]
    facets: Mapping[str, str] = field(default_factory=dict)
    more: tuple[Block, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table.

    key      names its file and its place in a page; letters, digits and hyphens
    caption  what it shows
    legend   what must be known to read it, a line each
    compact  a row a line where there is room: of the notes of a cell only the first is shown, the others are hidden
    opened   what a reader of a page sees below a row that is opened; for pages alone, since only there rows open
    """

    key: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    legend: tuple[str, ...] = ()
    compact: bool = False
    opened: str = ""

    def __post_init__(self) -> None:
        assert all(len(row.cells) == len(self.columns) for row in self.rows), f"table {self.key}: a row of other length"

    def without_empty_columns(self) -> Table:
        """The table without the columns, the first aside, in which every cell is a dash."""
        kept = [i for i in range(len(self.columns)) if not i or any(row.cells[i].text != NONE for row in self.rows)]
        rows = tuple(replace(row, cells=tuple(row.cells[i] for i in kept)) for row in self.rows)
        return replace(self, columns=tuple(self.columns[i] for i in kept), rows=rows)


def table(
    key: str,
    caption: str,
    columns: Sequence[Column | str],
    rows: Sequence[Sequence[Cell | str] | Row],
    legend: Sequence[str] = (),
) -> Table:
    """A table of cells and texts."""
    return Table(
        key,
        caption,
        tuple(one if isinstance(one, Column) else Column(one) for one in columns),
        tuple(one if isinstance(one, Row) else Row(tuple(map(cell, one))) for one in rows),
        tuple(legend),
    )


@dataclass(frozen=True)
class Numbers:
    """What a figure draws, as a table: titles with units, and rows of as many cells; None is an empty cell."""

    titles: Sequence[str] = ()
    rows: Sequence[Sequence[str | int | float | None]] = ()


@dataclass(frozen=True)
class Figure:
    """A figure with the words around it.

    label    above it
    caption  below it; says why there is nothing to draw where that is so
    svg      None where there is nothing to draw
    key      names the figure's files, unique within a document; empty: it has none
    numbers  what it draws
    about    kind of figure, scene, group: what a caption needs where no page stands around the figure
    reading  what its marks mean: the same, at the end of the caption
    """

    label: str
    caption: str
    svg: Markup | None
    key: str = ""
    numbers: Numbers = field(default_factory=Numbers)
    about: str = ""
    reading: str = ""

    @property
    def title(self) -> str:
        """What it is, where no page stands around it."""
        return f"{self.about}: {self.label}" if self.about else self.label

    @property
    def file_name(self) -> str:
        """What its files are called, without the ending."""
        return key_of(self.key)


@dataclass(frozen=True)
class Facts:
    """Names and what is said of each."""

    pairs: tuple[tuple[str, Cell], ...]


def facts(*pairs: tuple[str, Cell | str]) -> Facts:
    """Facts of cells and texts."""
    return Facts(tuple((name, cell(said)) for name, said in pairs))


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True)
class Code:
    """Lines to be typed, or that a program wrote."""

    lines: tuple[str, ...]


@dataclass(frozen=True)
class Item:
    """An item of a list, with items of its own."""

    text: str
    tone: Tone = Tone.PLAIN
    items: tuple[Item, ...] = ()
    link: str = ""


@dataclass(frozen=True)
class Items:
    """A list."""

    items: tuple[Item, ...]


def items(*texts: Item | str, tone: Tone = Tone.PLAIN) -> Items:
    """A list of items and texts."""
    return Items(tuple(one if isinstance(one, Item) else Item(one, tone) for one in texts))


@dataclass(frozen=True)
class Beside:
    """Blocks that stand in columns where there is room, one below the other where there is none."""

    columns: tuple[tuple[Block, ...], ...]


@dataclass(frozen=True)
class Gallery:
    """Figures of one kind, in a grid.

    least  width that a figure needs [rem]
    """

    figures: tuple[Figure, ...]
    least: float = 24.0


@dataclass(frozen=True)
class Embed:
    """A part of a page that needs a script, and that no other format has.

    markup  HTML of our own
    style   CSS that it needs
    script  JavaScript that it needs; the page's policy allows this text and no other
    instead what other formats say
    """

    markup: Markup
    style: Markup
    script: Markup
    instead: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a document.

    key      its place in a page: what links point at; letters, digits and hyphens
    title    its heading
    blocks   what it says
    summary  one line that says the most important, beside the heading
    folded   whether a page shows the heading and the summary alone until a reader opens it
    facets   by which readers filter: name to value
    """

    key: str
    title: str
    blocks: tuple[Block, ...]
    summary: str = ""
    folded: bool = False
    facets: Mapping[str, str] = field(default_factory=dict)


Block = Table | Figure | Gallery | Facts | Text | Code | Items | Beside | Embed | Section


@dataclass(frozen=True)
class Document:
    """All that a command has to say.

    title   what it is
    blocks  in order
    lead    one line below the title
    made_by what made it: lines for the end
    """

    title: str
    blocks: tuple[Block, ...]
    lead: str = ""
    made_by: tuple[Block, ...] = ()

    def tables(self) -> Iterator[Table]:
        """All tables that have a row, in order."""
        yield from (one for one in walk(self.blocks) if isinstance(one, Table) and one.rows)

    def figures(self) -> Iterator[Figure]:
        """All figures, in order."""
        yield from (one for one in walk(self.blocks) if isinstance(one, Figure))


def walk(blocks: Sequence[Block]) -> Iterator[Block]:
    """All blocks, each before those that it holds, in order."""
    for one in blocks:
        yield one
        if isinstance(one, Section):
            yield from walk(one.blocks)
        elif isinstance(one, Beside):
            for column in one.columns:
                yield from walk(column)
        elif isinstance(one, Gallery):
            yield from one.figures
        elif isinstance(one, Table):
            for row in one.rows:
                yield from walk(row.more)


def key_of(*words: object) -> str:
    """Words as a key, or as a file's name without its ending: lower-case letters, digits and hyphens."""
    plain = re.sub(r"[^a-z0-9]+", "-", "-".join(map(str, words)).lower()).strip("-")
    return plain[:_LONGEST_KEY].strip("-") or "figure"
