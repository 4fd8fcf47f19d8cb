"""Environments that failed, of runs that kept the states of these alone."""

from __future__ import annotations

from gpusimbench.evaluator.render.document import Block, Item, Items, Section
from gpusimbench.evaluator.report.failures import counted, failing_table
from gpusimbench.evaluator.report.source import Source
from gpusimbench.schemas.text import plural


def section(source: Source) -> Section | None:
    """None where no run kept failing environments alone."""
    results = [*source.shown, *source.hidden]
    runs = [run for result in results for run in result.group.recordings if run.failing is not None]
    if not runs:
        return None
    said = [Item(f"{r.path.name}: {counted(r.failing, r.configuration.n_env)}") for r in runs if r.failing is not None]
    blocks: list[Block] = [Items(tuple(said))]
    found = [
        (r.path.name, r.failing, r.simulation.overflow_bits if r.simulation else ())
        for r in runs
        if r.failing is not None and r.failing.failures
    ]
    if found:
        blocks.append(failing_table(found))
    failed = sum(bool(run.failing and run.failing.total) for run in runs)
    title = f"environments failed in {failed} of {plural(len(runs), 'run')} that kept failing environments alone"
    return Section("failing", "Environments that failed", tuple(blocks), title, folded=False)
