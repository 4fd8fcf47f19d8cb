"""A figure as a page shows it, with its words and its numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from markupsafe import Markup

from gpusimbench.evaluator.render.csv import Cell, to_csv

LARGEST_CSV = 256_000
"""Characters of a figure's numbers that a page carries; more of them are left to `gsb-eval --figures`."""

_LONGEST_NAME = 80


@dataclass(frozen=True)
class Numbers:
    """What a figure draws, as a table: titles with units, and rows of as many cells."""

    titles: Sequence[str] = ()
    rows: Sequence[Sequence[Cell]] = ()

    def csv(self) -> str:
        """The table as CSV; empty where there is none."""
        return to_csv(self.titles, self.rows) if self.titles else ""


@dataclass(frozen=True)
class Picture:
    """A figure with the words below it.

    label    above it
    caption  below it; says why there is nothing to draw where that is so
    svg      None where there is nothing to draw
    key      names the figure's files, unique within a page; empty: it has none
    numbers  what it draws
    about    what the page says above it and around it, for a caption that stands alone: kind of figure, scene, group
    """

    label: str
    caption: str
    svg: Markup | None
    key: str = ""
    numbers: Numbers = field(default_factory=Numbers)
    about: str = ""

    @property
    def title(self) -> str:
        """What it is, where no page stands around it."""
        return f"{self.about}: {self.label}" if self.about else self.label

    @property
    def file_name(self) -> str:
        """What its files are called, without the ending: letters, digits and hyphens, whatever the key says."""
        return file_name(self.key)


def file_name(*words: object) -> str:
    """Words as one name of a file, without an ending; what a stranger wrote names no folder and is not long."""
    plain = re.sub(r"[^a-z0-9]+", "-", "-".join(map(str, words)).lower()).strip("-")
    return plain[:_LONGEST_NAME].strip("-") or "figure"
