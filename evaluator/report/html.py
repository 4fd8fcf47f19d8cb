"""The report as one HTML page that needs nothing but itself: no network, no other file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

from markupsafe import Markup

from gpusimbench.evaluator.player.playback import Playback, playback_of
from gpusimbench.evaluator.render import document
from gpusimbench.evaluator.render.html import render_page
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.page import (
    consistency,
    density,
    deviations,
    divergence,
    dot_plot,
    playback,
    provenance,
    published,
    radar,
    recordings,
    remade,
)
from gpusimbench.evaluator.report.page.environment import environment
from gpusimbench.evaluator.report.page.section import Section
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.schemas.writing import write_files

SECTIONS: tuple[Callable[[Source], Section | None], ...] = (
    remade.section,
    playback.section,
    density.section,
    consistency.section,
    divergence.section,
    radar.section,
    dot_plot.section,
    deviations.section,
    published.section,
    provenance.section,
    recordings.section,
)
"""Of the page, in order; one that has nothing to say is None."""


def write_html(evaluation: Evaluation, folder: Path, *, published: bool, command: str) -> Path:
    """Write `index.html` into the folder, which is made where it is missing; returns the page's path.

    States are read again from the recordings, for the player. GsbError where it cannot be written; an earlier page is
    left as it was.
    """
    text = render_html(
        evaluation,
        published=published,
        command=command,
        playback=playback_of(Source(evaluation, published, command).shown),
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
    source = Source(evaluation, published, command, playback)
    whole = report(source)
    drawn = [_folded(made, source) for made in sections_of(source)]
    return render_page(replace(whole, blocks=(*whole.blocks, *drawn)))


def sections_of(source: Source) -> list[Section]:
    """The sections with templates of their own that have something to say."""
    return [made for section in SECTIONS if (made := section(source)) is not None]


def _folded(made: Section, source: Source) -> document.Section:
    common = {"evaluation": source.evaluation, "shown": source.shown, "hidden": source.hidden}
    body = environment().get_template(f"{made.key}.html.j2").render(**common, **made.context)
    embed = document.Embed(Markup(body), Markup(_style() + made.style), Markup(made.script))
    return document.Section(made.key, made.title, (embed,), folded=True)


@cache
def _style() -> str:
    return (Path(__file__).parent / "page" / "templates" / "sections.css").read_text(encoding="utf-8")
