"""The points in time of a history: a folder each, in the order in which their runs were made."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.known_files import read_all
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable
from gpusimbench.evaluator.results.evaluate import without_copies
from gpusimbench.evaluator.runs.cotenancy import with_peers
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.schemas import PARTIAL
from gpusimbench.schemas.errors import UsageError

ORDER = "points are in the order of the earliest start time that their recordings have; labels are names of folders"

_UTC = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")


@dataclass(frozen=True)
class Point:
    """One version or commit.

    label       name of its folder
    begins      earliest start time of its runs, UTC; empty where none says it
    runs        recordings that could be read, each run once
    unreadable  files that could not
    notes       on copies
    """

    label: str
    begins: str
    runs: tuple[Run, ...]
    unreadable: tuple[Unreadable, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Points:
    """All points of a history, in order, and what is said of the folder."""

    points: tuple[Point, ...]
    notes: tuple[str, ...]


def read_points(folder: Path, reader: Reader, work: Work) -> Points:
    """Read a history: folders in `folder` are points, hidden ones aside; recordings of a point lie in it and below it.

    UsageError where there is none, or where a run belongs to two points.
    """
    if not folder.is_dir():
        raise UsageError(f"--history is a folder that has a folder for each version or commit, and {folder} is none")
    places = {inside.name: _recordings(inside) for inside in sorted(folder.iterdir()) if _is_point(inside)}
    if not any(places.values()):
        raise UsageError(
            f"{folder} has no folder with recordings (*.mcap); --history takes a folder that has one for each version "
            "or commit"
        )
    notes = [f"{label} has no recordings (*.mcap), and is left out" for label, inside in places.items() if not inside]
    if loose := len(list(folder.glob("*.mcap"))):
        what = "recording that lies" if loose == 1 else "recordings that lie"
        notes.append(f"{loose} {what} in {folder.name} itself, in no folder of a version or commit: left out")
    wanted = [place for inside in places.values() for place in inside]
    read = dict(zip(wanted, read_all(wanted, reader, work), strict=True))
    points = [_point(label, [read[place] for place in inside]) for label, inside in places.items() if inside]
    _refuse_shared(points)
    undated = [point.label for point in points if point.runs and not point.begins]
    if undated:
        notes.append(f"no recording says when it was made in {', '.join(undated)}: placed first, by name")
    points.sort(key=lambda point: (point.begins, point.label))
    return Points(tuple(points), tuple(notes))


def _recordings(folder: Path) -> list[Path]:
    # what a run has reserved and not yet written to is empty
    partial = [path for path in folder.rglob(f"*.mcap{PARTIAL}") if path.stat().st_size > 0]
    return sorted([*(path for path in folder.rglob("*.mcap") if path.is_file()), *partial])


def _is_point(inside: Path) -> bool:
    return inside.is_dir() and not inside.name.startswith(".")


def _point(label: str, files: Sequence[Run | Unreadable]) -> Point:
    failures = [one for one in files if isinstance(one, Unreadable)]
    distinct, notes = without_copies([one for one in files if isinstance(one, Run)], failures)
    times = [run.provenance.created_utc for run in distinct if _UTC.fullmatch(run.provenance.created_utc)]
    return Point(label, min(times, default=""), tuple(with_peers(distinct)), tuple(failures), tuple(notes))


def _refuse_shared(points: Sequence[Point]) -> None:
    known: dict[str, tuple[str, Run]] = {}
    for point in points:
        for run in point.runs:
            label, first = known.setdefault(run.provenance.run_id, (point.label, run))
            if first is not run:
                raise UsageError(
                    f"{first.path} of {label} and {run.path} of {point.label} are one run, which belongs to one point "
                    "in time: remove it from the other"
                )
