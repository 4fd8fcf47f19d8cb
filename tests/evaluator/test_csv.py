"""Tables as CSV."""

from __future__ import annotations

import csv
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.render.table_files import to_csv

CELLS = st.none() | st.integers() | st.floats(allow_nan=False) | st.text()


def read(text: str) -> list[list[str]]:
    """The rows of a CSV file, as a strict reader finds them."""
    return list(csv.reader(io.StringIO(text, newline=""), strict=True))


@given(st.lists(st.tuples(CELLS, CELLS), max_size=5))
def test_every_table_can_be_read(rows: list[tuple[str | int | float | None, ...]]) -> None:
    """Give back as many rows and cells as were written, numbers without loss, and no formula."""
    text = to_csv(("a [m]", "b"), rows)
    header, *found = read(text)
    assert header == ["a [m]", "b"]
    assert text.count("\r\n") == len(rows) + 1 == text.count("\n") == text.count("\r")
    for row, cells in zip(rows, found, strict=True):
        for value, cell in zip(row, cells, strict=True):
            if value is None:
                assert cell == ""
            elif isinstance(value, str):
                assert cell == "-" or not cell.startswith(("=", "+", "-", "@", "\t", "\r"))
            else:
                assert type(value)(cell) == value


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1 m", "@SUM(A1)", "\t=1", " =HYPERLINK(0)", "\uff1d1", "\r=1"])
def test_formulas_are_text(text: str) -> None:
    """Put an apostrophe before what a spreadsheet would compute."""
    ((cell,),) = read(to_csv((text,), []))
    assert cell == f"'{text.strip()}"


def test_texts_of_strangers() -> None:
    """Keep quotes and commas, show control characters, and let no line break through."""
    ((_,), (cell,)) = read(to_csv(("a",), [['x, "y"\r\nz\x1b[2J']]))
    assert cell == 'x, "y" z\\x1b[2J'


def test_what_is_not_finite() -> None:
    """Write values that are not finite as readers of numbers know them."""
    assert read(to_csv(("a",), [[float("nan")], [float("-inf")]])) == [["a"], ["nan"], ["-inf"]]
