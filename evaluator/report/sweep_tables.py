"""Sweeps in a terminal: a row for each number of environments."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from evaluator.report import words
from evaluator.report.console import plain_table
from evaluator.report.numbers import NONE, mean_sd
from evaluator.report.text import printable
from evaluator.sweeps import SOURCES, Sweep, SweepPoint


def print_sweeps(console: Console, scene: str, sweeps: Sequence[Sweep]) -> None:
    """All sweeps of one scene in one table, and below it how far each goes and what its memory costs."""
    if not sweeps:
        return
    console.print(printable(f"{scene}, sweeps over the number of environments"), style="bold")
    table = plain_table(
        "", "N", "throughput [env-steps/s]", "memory increment", "contacts per env: mean / max", "runs"
    )  # fmt: skip
    for sweep in sweeps:
        for index, point in enumerate(sweep.points):
            cells = (sweep.label if index == 0 else "", f"{point.n_env:,}", *point_cells(sweep, point))
            table.add_row(*(Text(printable(cell)) for cell in cells))
    console.print(table)
    for sweep in sweeps:
        largest = NONE if sweep.n_max is None else f"{sweep.n_max:,}"
        where = " on ".join(filter(None, (sweep.key.version, sweep.key.device)))
        lines = [f"{sweep.label} ({where}): N_env^max {largest}: {words.shortened(sweep.ends)}"]
        lines += [f"  memory ({SOURCES[name]}) = {words.model(model)}" for name, model in sweep.models.items()]
        lines += [f"  no memory model ({SOURCES[name]}): {why_not}" for name, why_not in sweep.no_model.items()]
        for line in lines:
            console.print(printable(f"  {line}"), style="dim")
    console.print()


def point_cells(sweep: Sweep, point: SweepPoint) -> tuple[str, ...]:
    """Throughput, memory, contacts and runs at one number of environments."""
    runs = ", ".join(filter(None, (f"{point.complete} of {len(point.recordings)} complete", *point.causes)))
    return (
        mean_sd(point.result.metrics["fps"]),
        words.amount(point.result.metrics[sweep.memory]),
        words.counted(point.result.validity.of("contacts", "timed", "capture")),
        runs,
    )
