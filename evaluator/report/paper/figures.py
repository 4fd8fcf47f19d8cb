"""Every figure of the report as files for a paper: SVG, PDF and the numbers that it draws."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from gpusimbench.evaluator.render import latex
from gpusimbench.evaluator.render.csv import to_csv
from gpusimbench.evaluator.render.document import Figure
from gpusimbench.evaluator.render.figures.matrix import hatch
from gpusimbench.evaluator.render.figures.style import standalone
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.paper.pdf import to_pdf
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluation import Evaluation
from gpusimbench.schemas.text import printable
from gpusimbench.schemas.writing import write_files

INDEX = "figures.tex"

HEAD = """\
% Figures of an evaluation by gpusimbench; needs \\usepackage{graphicx}, pdfLaTeX or a newer engine.
% Each file lies beside this one; its SVG and the numbers that it draws have the same name.
"""


def write_figures(evaluation: Evaluation, folder: Path, *, published: bool) -> list[Path]:
    """Write all figures that have something to show; returns the files' paths, `figures.tex` last.

    NAME.svg, NAME.pdf  light theme; a white ground in the SVG, none in the PDF
    NAME.csv            what it draws, where it says so
    figures.tex         a figure environment for each, to be taken apart

    Raises:
        UsageError: reportlab is not installed.
        GsbError: a file cannot be written; those of an earlier time are as they were.
    """
    files: dict[Path, bytes | str] = {}
    environments = [HEAD]
    for name, picture in named(_pictures(Source(evaluation, published, ""))):
        svg = standalone(str(picture.svg), hatch())
        files[folder / f"{name}.svg"] = svg
        files[folder / f"{name}.pdf"] = to_pdf(svg, printable(picture.title))
        if picture.numbers.titles:
            files[folder / f"{name}.csv"] = to_csv(picture.numbers.titles, picture.numbers.rows)
        environments.append(latex.figure(name, ". ".join(filter(None, (picture.title, picture.caption)))))
    files[folder / INDEX] = "\n".join(environments)
    write_files(files)
    return list(files)


def named(pictures: Iterable[Figure]) -> Iterator[tuple[str, Figure]]:
    """Pictures with the names of their files, no name twice."""
    taken: set[str] = set()
    for picture in pictures:
        name, number = picture.file_name, 1
        while name in taken:
            number += 1
            name = f"{picture.file_name}-{number}"
        taken.add(name)
        yield name, picture


def _pictures(source: Source) -> Iterator[Figure]:
    yield from (one for one in report(source).figures() if one.svg and one.key)
