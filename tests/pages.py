"""A report's page as tests read it."""

from __future__ import annotations

import html
import re
from typing import IO

from gpusimbench.evaluator.render.document import Cell, Table
from gpusimbench.evaluator.render.markdown import render_markdown
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.document import in_short, report
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation


def part(page: str, key: str) -> str:
    """What a page has below the heading of a section, up to the next section."""
    assert f'<h2 id="{key}">' in page, key
    return page.partition(f'<h2 id="{key}">')[2].partition("<h2 ")[0]


def print_all(evaluation: Evaluation, stream: IO[str], *, published: bool = False) -> None:
    """Print what `gsb-eval --all` prints."""
    print_document(in_short(Source(evaluation, published, "")), stream)


def text_of(evaluation: Evaluation) -> str:
    """All that `gsb-eval --all` says, each cell on one line: what a terminal breaks between columns stands together."""
    shown = render_markdown(in_short(Source(evaluation, False, "")))
    return html.unescape(re.sub(r"</?[a-z][^>]*>", " ", shown).replace("\u200b", ""))


def tables_of(evaluation: Evaluation, *, published: bool = False) -> dict[str, Table]:
    """The tables of a report by their keys."""
    return {one.key: one for one in report(Source(evaluation, published, "")).tables()}


def rows_of(table: Table) -> dict[str, dict[str, Cell]]:
    """A table's cells by the text of the row's first cell, and the title of the column."""
    titles = [column.title for column in table.columns]
    return {row.cells[0].text: dict(zip(titles, row.cells, strict=True)) for row in table.rows}
