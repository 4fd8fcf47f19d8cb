"""A comparison of two sets as tables in a terminal."""

from __future__ import annotations

from typing import IO

from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.compare import words
from gpusimbench.evaluator.compare.compare import Compared, Result
from gpusimbench.evaluator.compare.finding import Change
from gpusimbench.evaluator.render.console import make_console, plain_table
from gpusimbench.schemas.text import printable

_COLUMNS = 4  # of a usual table's width: others are narrower here


def print_result(result: Result, stream: IO[str]) -> None:
    """Print it; what a stranger's recording says is printed as text, never as markup."""
    console = make_console(stream, columns=_COLUMNS)
    for compared in result.compared:
        _print_configuration(console, compared, result)
    for side, label, why in result.alone:
        _line(console, f"without a partner: {label} of {side}: {why}")
    for note in result.notes:
        _line(console, f"note: {note}")
    for line in words.methods(result.compared):
        console.print(printable(f"how: {line}"), style="dim")
    for line in (*words.legend(result), words.settings_line(result)):
        console.print(printable(line), style="dim")
    console.print(printable(words.headline(result)), style="bold red" if result.failing else "bold")


def _print_configuration(console: Console, compared: Compared, result: Result) -> None:
    console.print(printable(words.heading(compared)), style="bold")
    _line(console, f"  {words.runs(compared)}")
    if compared.pair.differs:
        _line(console, f"  differs: {'; '.join(compared.pair.differs)}")
    table = plain_table(*words.TITLES)
    for finding in compared.findings:
        if finding.change is not Change.NOT_COMPARED:
            style = "bold red" if finding.fails(result.settings) else ""
            table.add_row(*(Text(printable(cell), style=style) for cell in words.cells(finding, result)))
    console.print(table)
    for warning in compared.warnings:
        console.print(printable(f"  WARNING: {warning}"), style="bold")
    for line in words.undecided(compared, result):
        console.print(printable(f"  UNDECIDED: {line}"), style="bold")
    for line in (*words.tests(compared), *words.remarks(compared)):
        console.print(printable(f"  {line}"), style="dim")
    console.print()


def _line(console: Console, text: str) -> None:
    console.print(printable(text))
