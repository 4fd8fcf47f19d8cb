"""Environments that failed, of runs that kept the states of these alone."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.evaluator.read.failing import KINDS, EnvFailure, Failing
from gpusimbench.evaluator.render.document import Block, Cell, Column, Item, Items, Section, Table, Tone, table
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report.source import Source
from gpusimbench.schemas.provenance import OverflowBit
from gpusimbench.schemas.text import plural

_COLUMNS = (
    Column("env"),
    Column("step", "simulator step after which the failure first shows"),
    Column("what", "what happened first; of several things in one step, not finite, then overflow, is told"),
    Column("body", "body or joint"),
    Column("field", "of the state, and the component"),
    Column("value", "a position that is out of bounds is relative to the environment's origin [m]"),
    Column("kept steps", "whose states are in the recording"),
)


def failing_table(found: Sequence[tuple[str, Failing, Sequence[OverflowBit]]]) -> Table:
    """A row for each environment whose states are kept.

    found  of each recording its name, what failed, and what the engine's overflow bits are; one name is not shown
    """
    named = len(found) > 1
    rows = [
        [*([Cell(name, code=True)] if named else []), *_cells(failure, bits)]
        for name, failing, bits in found
        for failure in failing.failures
    ]
    columns = [*([Column("recording")] if named else []), *_COLUMNS]
    return table("failing", "Environments that failed first", columns, rows)


def counted(failing: Failing, n_env: int) -> str:
    """How many environments failed, and of what."""
    if not failing.total:
        return f"none of {plural(n_env, 'environment')} failed up to step {failing.last_step}"
    counts = ", ".join(f"{count} {kind}" for kind, count in zip(KINDS, failing.counts, strict=True) if count)
    kept = plural(len(failing.failures), "environment")
    return f"{failing.total} of {n_env} up to step {failing.last_step}: {counts}; states of {kept} are kept"


def _cells(failure: EnvFailure, bits: Sequence[OverflowBit]) -> list[Cell]:
    names = [bit.name for bit in bits if failure.overflow >> bit.bit & 1]
    what = f"{failure.kind}: {', '.join(names)}" if names else failure.kind
    return [
        Cell(str(failure.env), float(failure.env)),
        Cell(str(failure.step), float(failure.step)),
        Cell(what, tone=Tone.BAD),
        Cell(failure.item or NONE),
        Cell(f"{failure.field} {failure.component}" if failure.field else NONE),
        Cell(f"{failure.value:.6g}" if failure.field else NONE),
        Cell(f"{failure.first_step} to {failure.first_step + failure.steps - 1}"),
    ]


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
