"""Text of strangers in Markdown: shown as it is, never as markup, as a link or as a cell's end."""

from __future__ import annotations

import re

from evaluator.report.text import printable

_SPECIAL = re.compile(r"://|www\.|[&<>@\\`*_\[\]|~#!$^]")
_ENTITIES = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "@": "&#64;", "://": "&#58;//", "www.": "www&#46;"}
_LONGEST = 300


def one_line(text: str) -> str:
    """On one line, control characters made visible."""
    shown = printable(text)
    return shown.replace("\r", "\\r").replace("\n", "\\n").replace("\t", "\\t")


def cell(text: object) -> str:
    """For a table's cell or a sentence."""
    shown = one_line(str(text)).strip()
    if len(shown) > _LONGEST:
        shown = f"{shown[: _LONGEST - 3]}..."
    return _SPECIAL.sub(lambda found: _ENTITIES.get(found[0], f"\\{found[0]}"), shown) or "-"


def fenced(lines: list[str], language: str = "") -> str:
    """A block of code that nothing in it can end."""
    shown = [one_line(line) for line in lines]
    ticks = max((len(run) for line in shown for run in re.findall(r"`+", line)), default=0)
    fence = "`" * max(3, ticks + 1)
    return "\n".join([f"{fence}{language}", *shown, fence])
