"""The report as a document: the first screen, then a folded section for each topic."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Block, Code, Document, Section, Text, items
from gpusimbench.evaluator.render.html import render_page
from gpusimbench.evaluator.report.sections import (
    comparison,
    consistency,
    convergence,
    density,
    determinism_cost,
    deviations,
    divergence,
    episodes,
    mechanics,
    paper_tables,
    probed,
    problems,
    provenance,
    scaling,
    simulators,
    throughput,
    tosses,
    validity,
    variability,
)
from gpusimbench.evaluator.report.sections.overview import asked_of, overview
from gpusimbench.evaluator.report.source import Playback, Source, playback_of
from gpusimbench.evaluator.report.verdicts import usual
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.writing import write_files

SECTIONS: tuple[Callable[[Source], Section | Missing | None], ...] = (
    problems.section,
    problems.failing,
    simulators.section,
    tosses.section,
    episodes.section,
    variability.section,
    probed.section,
    mechanics.section,
    convergence.section,
    mechanics.laws,
    throughput.section,
    scaling.section,
    scaling.accumulation,
    validity.section,
    divergence.playback,
    density.section,
    consistency.section,
    divergence.section,
    determinism_cost.section,
    comparison.section,
    comparison.guidelines,
    deviations.section,
    paper_tables.section,
    paper_tables.published_figures,
    provenance.section,
    provenance.every_file,
)
"""Of a report, in order. A section that does not apply is None; where recordings lack what it needs, the title and the
reason stand for it."""

_OF_BODIES = (mechanics.section, divergence.playback, density.section, consistency.section)
"""Sections that nobody misses in a report on tasks, of which no bodies were recorded."""


def report(source: Source) -> Document:
    """The whole report of an evaluation."""
    made_by: tuple[Block, ...] = (
        Text("Made with:"),
        Code((source.command,)),
        Text("All figures as SVG, PDF and CSV: gsb-eval --figures DIR. All tables as files: gsb-eval --tables DIR."),
    )
    return Document(
        _title(source), (*overview(source), *_sections(source, SECTIONS)), asked_of(source.evaluation), made_by
    )


def _title(source: Source) -> str:
    """The questions that the recordings can answer, of one simulator by name or of several."""
    evaluation = source.evaluation
    names = list(dict.fromkeys(r.group.key.simulator for r in evaluation.results))
    alone = len(names) == 1
    asked = [f"Does {names[0]} repeat itself" if alone else "Which simulator repeats itself"]
    if evaluation.of_bodies:
        asked.append("is it right" if alone else "which is right")
    if evaluation.timed:
        asked.append("how fast is it" if alone else "how fast is each")
    return f"{', and '.join([', '.join(asked[:-1]), asked[-1]]) if len(asked) > 1 else asked[0]}?"


def in_short(source: Source) -> Document:
    """The same without where each recording comes from, which would take pages of a terminal: see gsb-info."""
    sections = [one for one in SECTIONS if one not in (provenance.section, provenance.every_file)]
    return Document("", (*overview(source), *_sections(source, sections)), asked_of(source.evaluation))


def _sections(source: Source, sections: Iterable[Callable[[Source], Section | Missing | None]]) -> list[Section]:
    """The sections that have something to say, and the reasons of the others in a last one."""
    asked = [one for one in sections if source.evaluation.of_bodies or one not in _OF_BODIES]
    found = [section(source) for section in asked]
    left_out = [one.reason for one in found if isinstance(one, Missing)]
    made = [one for one in found if isinstance(one, Section)]
    if left_out:
        said = plural(len(left_out), "section")
        made.append(Section("left-out", "Left out", (items(*left_out),), said, folded=True))
    return made


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
