"""The report as one HTML page that needs nothing but itself: no network, no other file."""

from __future__ import annotations

from pathlib import Path

from gpusimbench.evaluator.player.playback import Playback, playback_of
from gpusimbench.evaluator.render.html import render_page
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.report.verdicts import usual
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.schemas.writing import write_files


def write_html(evaluation: Evaluation, folder: Path, *, published: bool, command: str) -> Path:
    """Write `index.html` into the folder, which is made where it is missing; returns the page's path.

    States are read again from the recordings, for the player. GsbError where it cannot be written; an earlier page is
    left as it was.
    """
    text = render_html(
        evaluation,
        published=published,
        command=command,
        playback=playback_of(usual(Source(evaluation, published, command).shown)),
    )
    page = folder / "index.html"
    write_files({page: text})
    return page


def render_html(evaluation: Evaluation, *, published: bool, command: str, playback: Playback | None = None) -> str:
    """The page's text.

    published  whether the paper's figures are shown as well, marked as the paper's
    command    that made the page, as a shell would take it
    playback   environments in motion; None where the page is to have none
    """
    return render_page(report(Source(evaluation, published, command, playback)))
