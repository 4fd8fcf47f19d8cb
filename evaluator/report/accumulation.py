"""How variability goes with the number of environments, as rows of a table."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.render.console import plain_table
from gpusimbench.evaluator.render.numbers import NONE, distance
from gpusimbench.evaluator.results.accumulation import Accumulation
from gpusimbench.evaluator.statistics.jackknife import Interval
from gpusimbench.evaluator.statistics.matched import Variability
from gpusimbench.schemas.text import printable

TITLES = ("N", "runs", "between runs", "floor", "between envs", "between runs, all envs", "floor, all envs")
"""Distances are W1 in cm; the first three are of as many environments at each N."""


def print_accumulation(console: Console, found: Accumulation) -> None:
    """One sweep."""
    title = f"{found.scene}, {found.label}: variability against the number of environments, W1 [cm]"
    console.print(printable(title), style="bold")
    table = plain_table(*TITLES)
    for row in rows(found):
        table.add_row(*map(Text, row))
    console.print(table)
    for line in remarks(found):
        console.print(printable(f"  {line}"), style="dim")
    console.print()


def rows(found: Accumulation) -> Iterator[tuple[str, ...]]:
    """A row for each number of environments."""
    for point in found.points:
        yield (
            f"{point.n_env:,}",
            str(point.n_run),
            *_cells(point.matched),
            _value(point.matched.parallel),
            *(_cells(point.raw) if point.raw else (NONE, NONE)),
        )


def remarks(found: Accumulation) -> list[str]:
    """What has to be known to read them."""
    envs = "1 environment" if found.size == 1 else f"{found.size} environments"
    lines = [
        f"each run reduced to {envs}, mean of {found.draws} draws with seed {found.seed}; in brackets 95 % over runs",
        "distances of all environments fall with their number, as their floor does, and are not to be compared",
    ]
    return [*lines, *dict.fromkeys(f"N = {p.n_env:,}, all envs: {p.no_raw}" for p in found.points if p.no_raw)]


def _cells(found: Variability) -> tuple[str, str]:
    return _value(found.run_to_run), NONE if found.floor is None else distance(found.floor)


def _value(found: Interval | None) -> str:
    if found is None:
        return NONE
    if found.low is None or found.high is None:
        return distance(found.estimate)
    return f"{distance(found.estimate)} [{distance(found.low)}, {distance(found.high)}]"
