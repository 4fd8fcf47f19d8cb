"""What scripts draw into a page: the text between ``<!-- NAME: SCRIPT -->`` and ``<!-- end of NAME -->``."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def block(page: str, name: str) -> str:
    """The text between the markers. ValueError where the page does not have each of them once."""
    return _parts(page, name)[1]


def with_blocks(page: str, blocks: Mapping[str, str]) -> str:
    """The page with other text between markers, by their names. ValueError as of `block`."""
    for name, shown in blocks.items():
        before, _, behind = _parts(page, name)
        page = f"{before}\n{shown}\n{behind}"
    return page


def redraw(file: Path, blocks: Mapping[str, str]) -> None:
    """Write the page with other text between markers. ValueError as of `block`."""
    file.write_text(with_blocks(file.read_text(encoding="utf-8"), blocks), encoding="utf-8")


def _parts(page: str, name: str) -> tuple[str, str, str]:
    """The page with its first marker, the text between both, and the page from the second marker on."""
    before, rest = page.split(f"<!-- {name}: ")
    script, rest = rest.split(" -->\n", 1)
    end = f"\n<!-- end of {name} -->"
    shown, behind = rest.split(end)
    return f"{before}<!-- {name}: {script} -->", shown, end[1:] + behind
