"""An evaluation as one HTML page that needs nothing but itself: no network, no other file.

What recordings say is a stranger's text: the templates escape every value, figures escape their own. The page's policy
allows its own scripts by their digests and nothing else, and without them it lacks only its buttons.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from markupsafe import Markup

from gpusimbench import schemas
from gpusimbench.evaluator.player.playback import Playback, playback_of
from gpusimbench.evaluator.render.figures import palette, style
from gpusimbench.evaluator.render.scripts import policy, script
from gpusimbench.evaluator.report.page import (
    accumulation,
    consistency,
    density,
    deviations,
    divergence,
    dot_plot,
    guidelines,
    mechanics,
    playback,
    price_list,
    provenance,
    published,
    radar,
    recordings,
    remade,
    scaling,
    summary,
    throughput,
    validity,
    variability,
)
from gpusimbench.evaluator.report.page.environment import environment
from gpusimbench.evaluator.report.page.header import header
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.schemas.writing import write_files

SECTIONS: tuple[Callable[[Source], Section | None], ...] = (
    summary.section,
    remade.section,
    variability.section,
    playback.section,
    mechanics.section,
    throughput.section,
    scaling.section,
    accumulation.section,
    validity.section,
    density.section,
    consistency.section,
    divergence.section,
    price_list.section,
    radar.section,
    dot_plot.section,
    guidelines.section,
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
    sections = sections_of(source)
    scripts = [script("download.js"), *(Markup(s.script) for s in sections if s.script)]
    templates = environment()
    common = {"evaluation": evaluation, "shown": source.shown, "hidden": source.hidden}
    bodies = [Markup(templates.get_template(f"{s.key}.html.j2").render(**common, **s.context)) for s in sections]
    page = templates.get_template("page.html.j2").render(
        **common,
        **header(source),
        sections=list(zip(sections, bodies, strict=True)),
        styles=[Markup(s.style) for s in sections if s.style],
        command=command,
        version=schemas.__version__,
        colours={
            "light": Markup(palette.variables(dark=False)),
            "dark": Markup(palette.variables(dark=True)),
            "figures": Markup(style.css()),
        },
        figure_rules=json.dumps(style.resolved()),
        scripts=scripts,
        policy=policy(scripts),
    )
    return page.lstrip()


def sections_of(source: Source) -> list[Section]:
    """The sections that have something to say."""
    return [made for section in SECTIONS if (made := section(source)) is not None]
