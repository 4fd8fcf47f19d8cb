"""Text of strangers in Markdown: shown as it is, never as markup, as a link or as a cell's end."""

from __future__ import annotations

import re

from gpusimbench.schemas.text import line

_SPECIAL = re.compile(r"://|www\.|[&<>@\\`*_\[\]|~#!$^]")
_ENTITIES = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "@": "&#64;", "://": "&#58;//", "www.": "www&#46;"}
_LONGEST = 300


def cell(text: object) -> str:
    """For a table's cell or a sentence."""
    shown = line(str(text)).strip()
    if len(shown) > _LONGEST:
        shown = f"{shown[: _LONGEST - 3]}..."
    return _SPECIAL.sub(lambda found: _ENTITIES.get(found[0], f"\\{found[0]}"), shown) or "-"


def fenced(lines: list[str], language: str = "") -> str:
    """A block of code that nothing in it can end."""
    shown = [line(one) for one in lines]
    ticks = max((len(run) for one in shown for run in re.findall(r"`+", one)), default=0)
    fence = "`" * max(3, ticks + 1)
    return "\n".join([f"{fence}{language}", *shown, fence])
