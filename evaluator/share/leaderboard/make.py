"""gsb-share leaderboard: from recordings to a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.render.html import render_page
from gpusimbench.evaluator.results.evaluate import evaluate
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.share.dataset.checkup import WHOLE
from gpusimbench.evaluator.share.dataset.contents import LookedAt
from gpusimbench.evaluator.share.leaderboard.board import Board
from gpusimbench.evaluator.share.leaderboard.document import KIND, dump_csv, dump_json
from gpusimbench.evaluator.share.leaderboard.gathering import gather, recordings_of, without_doubles
from gpusimbench.evaluator.share.leaderboard.page import leaderboard_document
from gpusimbench.evaluator.share.leaderboard.reproduction import replays_of
from gpusimbench.evaluator.share.leaderboard.standing import sections
from gpusimbench.schemas import checks
from gpusimbench.schemas.errors import DamagedRecording, UsageError
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
