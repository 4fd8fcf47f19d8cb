"""A figure as a page shows it, with its words and its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

Cell = str | int | float | None


@dataclass(frozen=True)
class Numbers:
    """What a figure draws, as a table: titles with units, and rows of as many cells."""

    titles: Sequence[str] = ()
    rows: Sequence[Sequence[Cell]] = ()


@dataclass(frozen=True)
class Picture:
    """A figure with the words below it.

    label    above it
    caption  below it; says why there is nothing to draw where that is so
    svg      None where there is nothing to draw
    key      names the figure's files, unique within a page; empty: it has none
    numbers  what it draws
    """

    label: str
    caption: str
    svg: Markup | None
    key: str = ""
    numbers: Numbers = field(default_factory=Numbers)
