"""A table of texts, and how it is written: as CSV, Markdown or LaTeX."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

from gpusimbench.evaluator.render import latex
from gpusimbench.evaluator.render.csv import to_csv
from gpusimbench.schemas.text import line

_LONG, _LONG_FROM = "p{5cm}", 40


class Format(StrEnum):
    """What tables are written as."""

    CSV = "csv"
    MARKDOWN = "md"
    LATEX = "tex"
    PARQUET = "parquet"


@dataclass(frozen=True)
class TextTable:
    """A table as people read it.

    key      names its file
    caption  what it shows
    titles   of the columns, with units; the first names the row
    rows     as many texts as there are titles; a dash where there is no value
    """

    key: str
    caption: str
    titles: Sequence[str]
    rows: Sequence[Sequence[str]]


def as_csv(table: TextTable) -> str:
    """The texts, without a caption."""
    return to_csv(table.titles, table.rows)


def as_markdown(table: TextTable) -> str:
    """A table as GitHub and pandoc read it, its caption below."""
    lines = [table.titles, ["---", *("---:" for _ in table.titles[1:])], *table.rows]
    cells = ([*map(_markdown, line)] if line is not lines[1] else line for line in lines)
    return "".join(f"| {' | '.join(row)} |\n" for row in cells) + f"\nTable: {_markdown(table.caption)}\n"


def as_latex(table: TextTable) -> str:
    """A floating table with rules of booktabs; columns of long texts are paragraphs."""
    longest = (max(map(len, column)) for column in zip(*table.rows, strict=True))
    columns = "".join(_LONG if long > _LONG_FROM else "r" if i else "l" for i, long in enumerate(longest))
    body = "".join(f"    {_latex(row)}\n" for row in table.rows)
    return (
        "% needs \\usepackage{booktabs}\n\\begin{table}\n  \\centering\n"
        f"  \\caption{{{latex.escape(table.caption)}}}\n  \\label{{tab:{table.key}}}\n"
        f"  \\begin{{tabular}}{{{columns}}}\n    \\toprule\n    {_latex(table.titles)}\n    \\midrule\n"
        f"{body}    \\bottomrule\n  \\end{{tabular}}\n\\end{{table}}\n"
    )


WRITERS: dict[Format, Callable[[TextTable], str]] = {
    Format.CSV: as_csv,
    Format.MARKDOWN: as_markdown,
    Format.LATEX: as_latex,
}


def _latex(cells: Sequence[str]) -> str:
    # the group in front: a bracket or a star would belong to the end of the line before
    return "{}" + " & ".join(map(latex.escape, cells)) + r" \\"


def _markdown(text: str) -> str:
    shown = line(" ".join(text.split()))
    return "".join(f"\\{c}" if c in "\\|`*_<>[]#~$" else c for c in shown)
