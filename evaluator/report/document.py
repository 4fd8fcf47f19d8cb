"""The report as a document: the first screen, then a folded section for each topic."""

from __future__ import annotations

from collections.abc import Callable

from gpusimbench.evaluator.render.document import Block, Code, Document, Section, Text
from gpusimbench.evaluator.report.sections import (
    accumulation,
    determinism_cost,
    guidelines,
    mechanics,
    problems,
    scaling,
    throughput,
    validity,
    variability,
)
from gpusimbench.evaluator.report.sections.overview import asked_of, overview
from gpusimbench.evaluator.report.source import Source

SECTIONS: tuple[Callable[[Source], Section | None], ...] = (
    problems.section,
    variability.section,
    mechanics.section,
    throughput.section,
    scaling.section,
    accumulation.section,
    validity.section,
    determinism_cost.section,
    guidelines.section,
)
"""Of a report, in order; a section that has nothing to say is None."""

TITLE = "Which simulator repeats itself, which is right, and how fast is each?"


def report(source: Source) -> Document:
    """All that an evaluation says."""
    made_by: tuple[Block, ...] = (
        Text("Made with:"),
        Code((source.command,)),
        Text("All figures as SVG, PDF and CSV: gsb-eval --figures DIR. All tables as files: gsb-eval --tables DIR."),
    )
    return Document(TITLE, (*overview(source), *sections_of(source)), asked_of(source.evaluation), made_by)


def sections_of(source: Source) -> list[Section]:
    """The sections that have something to say."""
    return [made for section in SECTIONS if (made := section(source)) is not None]
