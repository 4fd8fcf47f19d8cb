"""What a reader must know before any figure: what was evaluated, and which files have problems."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.report.page.section import Source
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.evaluator.runs.groups import shown_status, status_notes
from gpusimbench.schemas.location import Location


@dataclass(frozen=True)
class Problem:
    """A file that a reader must know about, what is wrong, and why."""

    path: Path | Location
    kind: str
    reason: str


def header(source: Source) -> dict[str, Any]:
    """What the head of the page shows."""
    evaluation = source.evaluation
    notes = [(r.label, note) for r in evaluation.results for note in r.notes if note not in status_notes(r.group)]
    problems = list(_problems(evaluation))
    return {
        "problems": problems,
        "n_problem_file": len({p.path for p in problems}),
        "notes": [("", note) for note in evaluation.notes] + notes,
        "n_recording": sum(len(r.group.recordings) for r in evaluation.results),
    }


def _problems(evaluation: Evaluation) -> Iterator[Problem]:
    for failure in evaluation.unreadable:
        yield Problem(failure.path, "could not be read", str(failure.error))
    for result in evaluation.results:
        for recording in result.group.recordings:
            if recording.status != "complete":
                yield Problem(recording.path, shown_status(recording), recording.reason)
            for lost in recording.dropouts:
                yield Problem(recording.path, "lost data", lost)
