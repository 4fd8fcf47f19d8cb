"""gsb-share leaderboard: from recordings, each found, checked and read once, to a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.inputs.reader import Reader, Unreadable, read_all
from gpusimbench.evaluator.read.addresses import expand, stamp_of
from gpusimbench.evaluator.render.html import render_page
from gpusimbench.evaluator.results.evaluate import evaluate
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.share.dataset.contents import DAMAGED, WHOLE, Checkup, LookedAt, check_up, find, is_recording
from gpusimbench.evaluator.share.leaderboard.document import leaderboard_document
from gpusimbench.evaluator.share.leaderboard.formats import KIND, dump_csv, dump_json
from gpusimbench.evaluator.share.leaderboard.reproduction import replays_of
from gpusimbench.evaluator.share.leaderboard.standing import Board, sections
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, NothingComparable, UsageError
from gpusimbench.schemas.location import Place
from gpusimbench.schemas.writing import write_files

PAGE, JSON, CSV = "index.html", "leaderboard.json", "leaderboard.csv"


def make_leaderboard(places: Sequence[Place], folder: Path, *, title: str, sample_time: float, work: Work) -> Board:
    """Read recordings, and write the page and its data into a folder; files of another kind there are not overwritten.

    sample_time  simulated time at which positions are compared [s]
    """
    _check_free(folder)
    found = recordings_of(places)
    made = board(gather(found, sample_time, work), title=title, sample_time=sample_time, work=work)
    if work.store is not None:
        work.store.prune()
    write_files(
        {
            folder / PAGE: render_page(leaderboard_document(made)),
            folder / CSV: dump_csv(made),
            folder / JSON: dump_json(made),
        }
    )
    return made


def board(looked_at: Sequence[LookedAt], *, title: str, sample_time: float, work: Work) -> Board:
    """The leaderboard of some recordings."""
    evaluation = evaluate(without_doubles([one.read for one in looked_at]), sample_time=sample_time, work=work)
    counted = {str(r.path) for result in evaluation.results for r in result.group.recordings}
    reads = [one.read for one in looked_at if isinstance(one.read, Run) and str(one.read.path) in counted]
    whole = {one.checkup.content_hash for one in looked_at if one.checkup.outcome == WHOLE}
    return Board(
        title=title,
        sample_time=sample_time,
        sections=sections(evaluation, {one.name: one.checkup for one in looked_at}, replays_of(reads, whole)),
        unreadable=tuple((str(file.path), str(file.error)) for file in evaluation.unreadable),
        notes=evaluation.notes,
        recordings=len(counted),
    )


def _check_free(folder: Path) -> None:
    there = [name for name in (PAGE, JSON, CSV) if (folder / name).exists()]
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"--out is a folder, and {folder} is none")
    if there and not _is_ours(folder / JSON):
        raise UsageError(
            f"{folder} has {', '.join(there)} that no leaderboard wrote; they are left as they are: name another folder"
        )


def _is_ours(path: Path) -> bool:
    try:
        return checks.load(path.name, path.read_bytes()).get("kind") == KIND
    except (OSError, DamagedRecording):
        return False


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
    for place, read in zip(places, read_all(places, Reader(sample_time), work), strict=True):
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
