"""Every file, with what it is and its content hash."""

from __future__ import annotations

from gpusimbench.evaluator.render.document import EMPTY, Cell, Row, Section, Tone, table
from gpusimbench.evaluator.render.numbers import plural
from gpusimbench.evaluator.report.sections.rows import facets
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.runs.groups import shown_status
from gpusimbench.evaluator.runs.reader import Unreadable
from gpusimbench.evaluator.runs.run import Run

_TITLES = ("file", "status", "reason", "group", "run", "content hash", "created (UTC)")


def section(source: Source) -> Section | None:
    """None without a file."""
    rows = [_row(result, one) for result in source.evaluation.results for one in result.group.recordings]
    rows += [_unreadable(failure) for failure in source.evaluation.unreadable]
    if not rows:
        return None
    said = plural(len(rows), "file")
    return Section("recordings", "Recordings", (table("recordings", "", _TITLES, rows),), said, folded=True)


def _row(result: GroupResult, one: Run) -> Row:
    bad = one.status != "complete" or bool(one.dropouts)
    return Row(
        (
            Cell(one.path.name, code=True),
            Cell(shown_status(one) + (", lost data" if one.dropouts else ""), tone=Tone.BAD if bad else Tone.PLAIN),
            Cell(one.reason or EMPTY.text, notes=tuple(one.dropouts)),
            Cell(result.label),
            Cell(str(one.configuration.run_index), float(one.configuration.run_index)),
            Cell(one.content_hash or "none", code=bool(one.content_hash)),
            Cell(one.provenance.created_utc),
        ),
        facets(result),
    )


def _unreadable(failure: Unreadable) -> Row:
    said = Cell("could not be read", tone=Tone.BAD)
    return Row((Cell(failure.path.name, code=True), said, Cell(str(failure.error)), EMPTY, EMPTY, Cell("none"), EMPTY))
