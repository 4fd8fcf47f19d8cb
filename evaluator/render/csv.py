"""Tables as CSV (RFC 4180): numbers in full, and nothing that a spreadsheet would take for a formula."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence

from gpusimbench.schemas.text import line

Cell = str | int | float | None
"""None is an empty cell."""

_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")  # the wide ones begin formulas in some spreadsheets too
_DASH = "-"


def to_csv(titles: Sequence[str], rows: Iterable[Sequence[Cell]]) -> str:
    """A header and rows, lines ending in CR LF.

    Numbers are written so that reading them gives the same ones. Texts are a stranger's: one that begins as a formula
    does gets an apostrophe in front, and line breaks in it become spaces.
    """
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\r\n")
    writer.writerow([_text(title) for title in titles])
    writer.writerows([_cell(cell) for cell in row] for row in rows)
    return written.getvalue()


def _cell(cell: Cell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, str):
        return _text(cell)
    return repr(float(cell)) if isinstance(cell, float) else str(int(cell))


def _text(text: str) -> str:
    shown = line(" ".join(text.split()))
    return f"'{shown}" if shown.startswith(_FORMULA) and shown != _DASH else shown
