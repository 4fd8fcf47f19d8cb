"""Sweeps in a terminal: a row for each number of environments."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.text import Text

from gpusimbench.evaluator.render.console import plain_table
from gpusimbench.evaluator.render.numbers import NONE, mean_sd
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.sweeps import SOURCES, Sweep, SweepPoint
from gpusimbench.schemas.text import printable


def print_sweeps(console: Console, scene: str, sweeps: Sequence[Sweep]) -> None:
    """All sweeps of one scene in one table, and below it how far each goes and what its memory costs."""
    if not sweeps:
        return
    console.print(printable(f"{scene}, sweeps over the number of environments"), style="bold")
    points = [point.result for sweep in sweeps for point in sweep.points]
    # settings are those of a sweep, and stand below; the points of one may differ in how long they took
    beside = timed.columns_within([[p.result.timed for p in sweep.points] for sweep in sweeps])
    table = plain_table(
        "", "N", FPS.titled, *(column.title for column in beside), "memory increment",
        "contacts per env: mean / max", "runs",
    )  # fmt: skip
    for sweep in sweeps:
        for index, point in enumerate(sweep.points):
            cells = (sweep.label if index == 0 else "", f"{point.n_env:,}", *point_cells(sweep, point, beside))
            table.add_row(*(Text(printable(cell)) for cell in cells))
    console.print(table)
    label_of = {point.result.label: sweep.label for sweep in sweeps for point in sweep.points}
    for line in timed.remarks(points, named=lambda result: label_of[result.label]):
        console.print(printable(f"  {line}"), style="dim")
    for sweep in sweeps:
        largest = NONE if sweep.n_max is None else f"{sweep.n_max:,}"
        where = " on ".join(filter(None, (sweep.key.version, sweep.key.device)))
        lines = [f"{sweep.label} ({where}): N_env^max {largest}: {words.shortened(sweep.ends)}"]
        lines += [f"  {line}" for line in timed.shared(p.result.timed for p in sweep.points)]
        lines += [f"  memory ({SOURCES[name]}) = {words.model(model)}" for name, model in sweep.models.items()]
        lines += [f"  no memory model ({SOURCES[name]}): {why_not}" for name, why_not in sweep.no_model.items()]
        for line in lines:
            console.print(printable(f"  {line}"), style="dim")
    console.print()


def point_cells(sweep: Sweep, point: SweepPoint, beside: Sequence[timed.Column]) -> tuple[str, ...]:
    """Throughput with what stands beside it, memory, contacts and runs at one number of environments."""
    runs = ", ".join(filter(None, (f"{point.complete} of {len(point.recordings)} complete", *point.causes)))
    return (
        mean_sd(point.result.metrics["fps"]),
        *timed.cells(beside, point.result.timed),
        words.amount(point.result.metrics[sweep.memory]),
        words.counted(point.result.validity.of("contacts", "timed", "capture")),
        runs,
    )
