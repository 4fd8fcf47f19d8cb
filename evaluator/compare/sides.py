"""The files of base and of head."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable
from gpusimbench.evaluator.inputs.sample_time import notes_on, read_sampled
from gpusimbench.evaluator.results.evaluate import without_copies
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.location import Place


@dataclass(frozen=True)
class Side:
    """One of the two sets.

    files       recordings that could be read, each run once
    unreadable  files that could not
    notes       on copies
    """

    files: tuple[Run, ...]
    unreadable: tuple[Unreadable, ...]
    notes: tuple[str, ...]


def read_sides(
    base: Sequence[Place], head: Sequence[Place], reader: Reader, work: Work, across: Collection[str] = ()
) -> tuple[Side, Side]:
    """Read both sets; UsageError where a run is in both.

    across  what may differ between base and head, see `compare`; states of two scenes are sampled at one time
    """
    sampled = read_sampled([*base, *head], reader, work, together="scene" in across)
    one, other = (_side([sampled.files[place] for place in places]) for places in (base, head))
    one = replace(one, notes=(*one.notes, *notes_on(sampled.shorter, sampled.time, (*one.files, *other.files))))
    ours = {file.provenance.run_id: file for file in one.files}
    for file in other.files:
        if same := ours.get(file.provenance.run_id):
            raise UsageError(
                f"{same.path} of base and {file.path} of head are one run, which tells nothing when it "
                "is compared with itself; record a second set"
            )
    return one, other


def _side(files: Sequence[Run | Unreadable]) -> Side:
    failures = [f for f in files if isinstance(f, Unreadable)]
    distinct, notes = without_copies([f for f in files if isinstance(f, Run)], failures)
    return Side(tuple(distinct), tuple(failures), tuple(notes))
