"""Tables of a document as files: CSV with numbers in full, Markdown, LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Sequence

from gpusimbench.evaluator.render.document import Cell, Document, Table
from gpusimbench.evaluator.render.formats import Format
from gpusimbench.evaluator.render.markdown import table_markdown
from gpusimbench.schemas.text import line, printable

_SPECIAL = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
    "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "|": r"\textbar{}", '"': r"\textquotedblright{}", "`": r"\textasciigrave{}", "'": r"\textquotesingle{}",
}  # fmt: skip

_SIGNS = {
    "±": r"$\pm$", "×": r"$\times$", "−": "$-$", "≤": r"$\le$", "≥": r"$\ge$", "µ": r"$\mu$", "°": r"$^\circ$",
    "†": r"$\dagger$", "·": r"$\cdot$",
    "→": r"$\to$", "–": "--", "—": "---", "…": r"\dots{}", "“": "``", "”": "''", "‘": "`", "’": "'",
    "\u2009": r"\,", "\u202f": r"\,", "\u00a0": "~",
}  # fmt: skip

_RAISED = dict(
    zip("\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079\u207a\u207b", "0123456789+-", strict=True)
)
_LAST_LATIN = 0x17F  # what LaTeX knows without a package
_NEEDS_T1 = frozenset("ÐðÞþĄąĐđĘęĮįŊŋŲų")  # errors with LaTeX's default fonts
_UNKNOWN = frozenset("ĦħĸĿŀŉŦŧſ")  # errors with any

_LONG, _LONG_FROM = "p{5cm}", 40


def escape(text: str) -> str:
    """Text in which nothing is a command; what pdfLaTeX has no letter for stands as its number."""
    return "".join(map(_letter, printable(text)))


def _letter(c: str) -> str:
    if c in _SPECIAL:
        return _SPECIAL[c]
    if c in _SIGNS:
        return _SIGNS[c]
    if c in _RAISED:
        return f"$^{{{_RAISED[c]}}}$"
    if c.isspace():
        return " "
    known = c.isalpha() and ord(c) <= _LAST_LATIN and c not in _NEEDS_T1 | _UNKNOWN
    return c if c.isascii() or known else f"[U+{ord(c):04X}]"


def figure(file_name: str, caption: str) -> str:
    """A floating figure of a file, with its caption and a label of the same name."""
    return (
        "\\begin{figure}\n  \\centering\n"
        f"  \\includegraphics[width=\\linewidth]{{{file_name}}}\n"
        f"  \\caption{{{escape(caption)}}}\n  \\label{{fig:{file_name}}}\n\\end{{figure}}\n"
    )


def table_files(document: Document, formats: Iterable[Format]) -> dict[str, bytes]:
    """Every table of a document that has a row in each of the formats, Parquet aside, by the name of its file.

    A key that two tables have is numbered.
    """
    named = _by_unique_name(document.tables())
    wanted = [(one, _WRITERS[one]) for one in formats if one in _WRITERS]
    return {
        f"{name}.{one.value}": write(table).encode("utf-8", "backslashreplace")
        for name, table in named.items()
        for one, write in wanted
    }


def as_csv(table: Table) -> str:
    """Numbers in full, each interval as two columns more, and what stands below values as a column of its own."""
    columns = [_csv_column(title.title, [row.cells[i] for row in table.rows]) for i, title in enumerate(table.columns)]
    flat = [(title, column) for group in columns for title, column in group]
    return to_csv([title for title, _ in flat], list(zip(*(column for _, column in flat), strict=True)))


def as_latex(table: Table) -> str:
    """A floating table with rules of booktabs; columns of long texts are paragraphs."""
    texts = [[_joined(one) for one in row.cells] for row in table.rows]
    longest = (max(map(len, column)) for column in zip(*texts, strict=True))
    columns = "".join(_LONG if long > _LONG_FROM else "r" if i else "l" for i, long in enumerate(longest))
    body = "".join(f"    {_latex(row)}\n" for row in texts)
    caption = ". ".join([table.caption, *table.legend])
    return (
        "% needs \\usepackage{booktabs}\n\\begin{table}\n  \\centering\n"
        f"  \\caption{{{escape(caption)}}}\n  \\label{{tab:{table.key}}}\n"
        f"  \\begin{{tabular}}{{{columns}}}\n    \\toprule\n    {_latex([c.title for c in table.columns])}\n"
        f"    \\midrule\n{body}    \\bottomrule\n  \\end{{tabular}}\n\\end{{table}}\n"
    )


_WRITERS: dict[Format, Callable[[Table], str]] = {
    Format.CSV: as_csv,
    Format.MARKDOWN: table_markdown,
    Format.LATEX: as_latex,
}


def _by_unique_name(tables: Iterable[Table]) -> dict[str, Table]:
    found: dict[str, Table] = {}
    for table in tables:
        name, number = table.key, 1
        while name in found:
            number += 1
            name = f"{table.key}-{number}"
        found[name] = table
    return found


def _csv_column(title: str, cells: Sequence[Cell]) -> Iterator[tuple[str, list[CsvCell]]]:
    numeric = any(one.value is not None for one in cells)
    yield title, [one.value if one.value is not None else one.text if numeric else _joined(one) for one in cells]
    if any(one.ci95 for one in cells):
        for index, end in enumerate(("low", "high")):
            yield f"{title}, 95 % {end}", [one.ci95[index] if one.ci95 else None for one in cells]
    if numeric and any(one.notes for one in cells):
        yield f"{title}, remarks", ["; ".join(one.notes) for one in cells]


def _joined(said: Cell) -> str:
    head = " ".join(part for part in (said.text, said.range) if part)
    return "; ".join([head, *said.notes])


def _latex(cells: Sequence[str]) -> str:
    # the group in front: a bracket or a star would belong to the end of the line before
    return "{}" + " & ".join(map(escape, cells)) + r" \\"


CsvCell = str | int | float | None
"""None is an empty cell."""

_FORMULA = tuple("=+-@\uff1d\uff0b\uff0d\uff20")  # the wide ones begin formulas in some spreadsheets too
_DASH = "-"


def to_csv(titles: Sequence[str], rows: Iterable[Sequence[CsvCell]]) -> str:
    """A header and rows as CSV (RFC 4180), lines ending in CR LF.

    Numbers are written so that reading them gives the same ones. Texts are a stranger's: one that begins as a formula
    does gets an apostrophe in front, and line breaks in it become spaces.
    """
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\r\n")
    writer.writerow([_csv_text(title) for title in titles])
    writer.writerows([_csv_cell(cell) for cell in row] for row in rows)
    return written.getvalue()


def _csv_cell(cell: CsvCell) -> str:
    if cell is None:
        return ""
    if isinstance(cell, str):
        return _csv_text(cell)
    return repr(float(cell)) if isinstance(cell, float) else str(int(cell))


def _csv_text(text: str) -> str:
    shown = line(" ".join(text.split()))
    return f"'{shown}" if shown.startswith(_FORMULA) and shown != _DASH else shown
