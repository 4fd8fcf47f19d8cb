"""The recordings of a leaderboard: found, checked and read, each once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from gpusimbench.evaluator.check.protocol import unmet_by_file
from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.read.addresses import expand
from gpusimbench.evaluator.read.stamp import stamp_of
from gpusimbench.evaluator.runs.known_files import read_all
from gpusimbench.evaluator.runs.reader import Reader, Unreadable
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.share.dataset.checkup import DAMAGED, Checkup, check_up
from gpusimbench.evaluator.share.dataset.contents import LookedAt, is_recording
from gpusimbench.evaluator.share.dataset.folder import find
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable
from gpusimbench.schemas.location import Place


def recordings_of(places: Sequence[Place]) -> list[Place]:
    """Files as they are, those of folders and of the folders below them, and those that addresses stand for; each once.

    NothingComparable where there are none.
    """
    found: dict[object, Place] = {}
    for place in places:
        for path in _inside(place) if isinstance(place, Path) and place.is_dir() else expand([place]):
            found.setdefault(path.resolve() if isinstance(path, Path) else path, path)
    if not found:
        raise NothingComparable("there is no recording (*.mcap) in what was named: nothing to rank")
    return list(found.values())


def _inside(folder: Path) -> Iterator[Path]:
    yield from (folder / path for path in find(folder).files if is_recording(path))


def gather(places: Sequence[Place], sample_time: float, work: Work) -> list[LookedAt]:
    """Check and read every recording, in order of the places; what was found before is taken from the work's store."""
    looked_at = []
    for place, read in zip(places, read_all(places, Reader(sample_time, unmet_by_file), work), strict=True):
        checkup = _checked(place, work)
        if checkup.outcome == DAMAGED and not isinstance(read, Unreadable):
            read = Unreadable(place, DamagedRecording("; ".join(checkup.findings)))
        looked_at.append(LookedAt(str(place), checkup, read))
    return looked_at


def without_doubles(reads: Sequence[Run | Unreadable]) -> list[Run | Unreadable]:
    """All of them; those of one run id with several contents as damaged, each: which was changed nobody can tell.

    Otherwise the name of a file would decide which of them counts, and its author chooses that.
    """
    contents: dict[str, set[str]] = {}
    for read in reads:
        if isinstance(read, Run) and read.content_hash:
            contents.setdefault(read.provenance.run_id, set()).add(read.content_hash)
    return [
        read if isinstance(read, Unreadable) or len(contents.get(read.provenance.run_id, ())) < 2 else _double(read)
        for read in reads
    ]


def _double(read: Run) -> Unreadable:
    why = (
        f"another recording has its run id, {read.provenance.run_id}, and another content: one of them was "
        "changed, and neither counts; leave that one out"
    )
    return Unreadable(read.path, DamagedRecording(why))


def _checked(place: Place, work: Work) -> Checkup:
    stamp = stamp_of(place)
    if work.store is None or not stamp:
        return check_up(place, place.name)
    key = work.store.key(check_up, stamp)
    known: Checkup | None = work.store.get(key, Checkup)
    if known is not None:
        return known
    checkup = check_up(place, place.name)
    if stamp_of(place) == stamp:  # it is still the file that was looked at
        work.store.put(key, checkup)
    return checkup
