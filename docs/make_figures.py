"""Redraws what README.md shows from recordings/: the table between its markers, and docs/figures/density.svg.

usage: python docs/make_figures.py
"""

from __future__ import annotations

import io
import re
from pathlib import Path

from page_blocks import redraw

from gpusimbench.evaluator.render.figures import palette, style
from gpusimbench.evaluator.render.figures.svg import text
from gpusimbench.evaluator.render.terminal import print_document
from gpusimbench.evaluator.report.brief import brief
from gpusimbench.evaluator.report.document import render_html
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from gpusimbench.evaluator.runs.labels import parts_of

ROOT = Path(__file__).resolve().parent.parent
_TITLE, _INDENT, _GAP = 40, 44, 20


def shipped() -> Evaluation:
    """The evaluation of the recordings that ship with the project."""
    return evaluate_files(sorted((ROOT / "recordings").glob("*.mcap")))


def table(evaluation: Evaluation) -> str:
    """What gsb-eval prints, as Markdown."""
    stream = io.StringIO()
    print_document(brief(evaluation), stream)
    shown = "\n".join(line.rstrip() for line in stream.getvalue().splitlines()).strip()
    return f"```text\n{shown}\n```"


def picture(evaluation: Evaluation) -> str:
    """The report's density maps beside each other, as one SVG that follows the page's light or dark theme."""
    page = render_html(evaluation, published=False, command="")
    maps = re.findall(r"<svg [^>]*Density map of.*?</svg>", page, re.DOTALL)
    assert maps
    parts, left, height = [], 0.0, 0.0
    for one, result in zip(maps, evaluation.results, strict=True):
        box = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', one)
        assert box is not None
        width, tall = map(float, box.groups())
        name, settings = parts_of(result.label)
        placed = one.replace("<svg ", f'<svg x="{left:g}" y="{_TITLE}" width="{width}" height="{tall}" ', 1)
        title = text(name, left + _INDENT, 14) + text(", ".join(settings), left + _INDENT, 30, class_="small")
        parts.append(title + placed)
        left, height = left + width + _GAP, max(height, tall + _TITLE)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {left - _GAP:g} {height:g}">'
        f"<style>\n{_style()}\n</style>{''.join(parts)}</svg>\n"
    )


def _style() -> str:
    light, dark = palette.variables(dark=False), palette.variables(dark=True)
    font = "--font: system-ui, sans-serif;"
    return f":root {{ {font} {light} }}\n@media (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}\n{style.css()}"


def main() -> None:
    """Write both."""
    evaluation = shipped()
    readme = ROOT / "README.md"
    redraw(readme, {"table": table(evaluation)})
    target = ROOT / "docs" / "figures" / "density.svg"
    target.parent.mkdir(exist_ok=True)
    target.write_text(picture(evaluation), encoding="utf-8")
    print(f"{readme}\n{target}")


if __name__ == "__main__":
    main()
