"""Files that are evaluated or compared together, each run once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gpusimbench.evaluator.inputs.reader import Unreadable
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import DamagedRecording


@dataclass(frozen=True)
class FileSet:
    """A set of files as they were read.

    runs        that could be read, each once
    unreadable  files that could not be read, and those that have the run id of another run
    notes       on copies, a sentence each
    """

    runs: tuple[Run, ...]
    unreadable: tuple[Unreadable, ...] = ()
    notes: tuple[str, ...] = ()


def without_copies(files: Iterable[Run | Unreadable]) -> FileSet:
    """Count each run once; a file that has the run id of another file, and another content, is unreadable."""
    files = list(files)
    runs: dict[str, Run] = {}
    unreadable = [file for file in files if isinstance(file, Unreadable)]
    notes: list[str] = []
    # of a whole file and one that was cut short, the whole one stays
    for run in sorted((file for file in files if isinstance(file, Run)), key=lambda run: run.status == "incomplete"):
        first = runs.setdefault(run.provenance.run_id, run)
        if first is run:
            continue
        if run.content_hash in (first.content_hash, ""):
            notes.append(f"{run.path.name} is a copy of {first.path.name}; it counts once")
        else:
            why = f"{run.path} has the run id of {first.path.name} and another content: one of them was changed"
            unreadable.append(Unreadable(run.path, DamagedRecording(why)))
    return FileSet(tuple(runs.values()), tuple(unreadable), tuple(notes))
