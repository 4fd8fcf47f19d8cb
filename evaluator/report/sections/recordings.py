"""Every file, with what it is and its content hash."""

from __future__ import annotations

from collections import Counter

from gpusimbench.evaluator.inputs.reader import Unreadable
from gpusimbench.evaluator.render.document import EMPTY, Block, Cell, Row, Section, Table, Tone, key_of, table
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report.sections.rows import facets, ordered
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import shown_status
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.text import plural

_TITLES = ("file", "status", "group", "run", "content hash", "created (UTC)")
_DAY = len("2026-11-23")
_FEW = 10
"""Files that are listed at once; of more, a summary stands before the closed list."""


def section(source: Source) -> Section | None:
    """Every file; of many, a summary by simulator and the list closed below it. None without a file."""
    results, unreadable = source.evaluation.results, source.evaluation.unreadable
    rows = [_unreadable(failure) for failure in unreadable]
    rows += [_row(result, one) for result in results for one in result.group.recordings]
    if not rows:
        return None
    every = table("recordings", "", _TITLES, rows)
    blocks: tuple[Block, ...] = (every,)
    if len(rows) > _FEW:
        said = "with content hash and date"
        blocks = (_in_short(source), Section("recordings-files", "Every file", (every,), said, folded=True))
    parts = [plural(len(rows), "file")]
    if bad := sum(_bad(one) for result in results for one in result.group.recordings):
        parts.append(f"{bad} not complete")
    if unreadable:
        parts.append(f"{len(unreadable)} could not be read")
    return Section("recordings", "Recordings", blocks, ", ".join(parts), folded=True)


def _in_short(source: Source) -> Table:
    titles = ("simulator", "files", "status", "scenes", "created (UTC)")
    rows = [_of_simulator(name, found) for name, found in ordered(source.evaluation.results, "simulator").items()]
    rows.sort(key=lambda row: all(cell.tone is not Tone.BAD for cell in row.cells))  # what deviates comes first
    legend = ["Files that are not complete or could not be read are listed under “What is wrong with this set”."]
    return table("recordings-simulators", "Files, by simulator", titles, rows, legend)


def _of_simulator(name: str, results: list[GroupResult]) -> Row:
    runs = [one for result in results for one in result.group.recordings]
    ends = sorted(Counter(_status(one) for one in runs).items(), key=lambda one: one[0] != "complete")
    days = sorted(one.provenance.created_utc[:_DAY] for one in runs if one.provenance.created_utc)
    bad = any(map(_bad, runs))
    return Row(
        (
            Cell(name, link=key_of("simulator", name)),
            Cell(str(len(runs)), float(len(runs))),
            Cell(", ".join(f"{count} {end}" for end, count in ends), tone=Tone.BAD if bad else Tone.PLAIN),
            Cell(", ".join(dict.fromkeys(result.group.key.scene for result in results))),
            Cell(NONE if not days else days[0] if days[0] == days[-1] else f"{days[0]} to {days[-1]}"),
        ),
        {"simulator": name},
    )


def _row(result: GroupResult, one: Run) -> Row:
    return Row(
        (
            Cell(one.path.name, code=True),
            Cell(_status(one), tone=Tone.BAD if _bad(one) else Tone.PLAIN),
            Cell(result.label),
            Cell(str(one.configuration.run_index), float(one.configuration.run_index)),
            Cell(one.content_hash or "none", code=bool(one.content_hash)),
            Cell(one.provenance.created_utc),
        ),
        facets(result.group.key),
    )


def _bad(one: Run) -> bool:
    return one.status != "complete" or bool(one.dropouts)


def _status(one: Run) -> str:
    return shown_status(one) + (", lost data" if one.dropouts else "")


def _unreadable(failure: Unreadable) -> Row:
    said = Cell("could not be read", tone=Tone.BAD)
    return Row((Cell(failure.path.name, code=True), said, EMPTY, EMPTY, Cell("none"), EMPTY))
