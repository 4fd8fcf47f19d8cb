"""Physics of groups as tables in a terminal, as a fragment of a page, and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO, Any

from markupsafe import Markup
from rich.text import Text

from gpusimbench.evaluator.render.console import make_console, plain_table
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.results.fidelity import Fidelity, FidelityRow, Verdict
from gpusimbench.schemas.text import printable

TITLES = ("check", "measured", "range", "allowed", "tolerance", "verdict")
_AT_REST = "at rest at the sample time (mechanics does not demand it)"
_NUMBERS = ("measured", "range", "allowed", "tolerance")


def print_fidelity(found: Sequence[Fidelity], stream: IO[str]) -> None:
    """Print a table for each group; checks that do not apply stand beneath it with their reasons."""
    console = make_console(stream)
    for one in found:
        console.print(printable(f"physics of {heading(one)}"), style="bold")
        if one.why_not:
            console.print(printable(f"  not applicable: {one.why_not}"))
        for title, rows in _parts(one):
            if title:
                console.print(title)
            table = plain_table(*TITLES)
            for row in rows:
                style = "bold" if row.broken else ""
                table.add_row(*(Text(printable(cell), style=style) for cell in cells(row)))
            console.print(table)
        for line in remarks(one):
            console.print(printable(f"  {line}"), style="dim")
        console.print()


def fidelity_html(found: Sequence[Fidelity]) -> Markup:
    """The same as a fragment of a page: a heading and a table for each group, every text escaped."""
    parts = []
    for one in found:
        parts.append(Markup("<h3><bdi>{}</bdi></h3>\n").format(printable(heading(one))))
        if one.why_not:
            parts.append(Markup("<p>Not applicable: {}.</p>\n").format(printable(one.why_not)))
            continue
        for title, rows in _parts(one):
            if title:
                parts.append(Markup("<p>{}</p>\n").format(title.capitalize()))
            parts.append(_table(f"Physics of {one.label}{f', {title}' if title else ''}", rows))
        lines = [Markup("<li>{}</li>").format(printable(line)) for line in remarks(one)]
        if lines:
            parts.append(Markup("<ul>{}</ul>\n").format(Markup("").join(lines)))
    return Markup("").join(parts)


def fidelity_record(one: Fidelity) -> dict[str, Any]:
    """One group's physics for JSON: every check by its key, with its verdict."""
    record: dict[str, Any] = {
        "label": one.label,
        "scene": one.scene,
        "runs": one.runs,
        "n_env": one.n_env,
        "looked_at": one.looked_at,
        "exactness": one.exactness,
        "why_not": one.why_not,
        "checks": {},
    }
    for row in one.rows:
        shown: dict[str, Any] = {
            "title": row.check.title,
            "unit": row.check.unit,
            "demanded": row.check.demanded,
            "verdict": row.verdict.value,
            "reason": row.reason,
        }
        if row.verdict is not Verdict.NOT_APPLICABLE:
            names = ("mean", "least", "most", "runs", "count", "low", "high", "tolerance", "broken", "of_runs")
            shown |= {name: getattr(row, name) for name in names}
            shown |= {"tolerance_formula": row.of, "notes": list(row.notes)}
        record["checks"][row.check.key] = shown
    return record


def heading(one: Fidelity) -> str:
    """Which group, and how much of it was looked at."""
    runs = f"{one.runs} run{'' if one.runs == 1 else 's'}"
    envs = f"{one.looked_at} of {one.n_env} envs" if one.exactness == "sampled" else f"{one.n_env} envs"
    return f"{one.label}, {one.scene}: {runs}, {envs}" if one.scene else one.label


def cells(row: FidelityRow) -> tuple[str, ...]:
    """A measured check as the texts of a table's row, in the order of its titles."""
    unit = f" [{row.check.unit}]" if row.check.unit else ""
    verdict = row.verdict.value.upper() if row.verdict is Verdict.BROKEN else row.verdict.value
    if row.broken:
        verdict += f" {row.broken} of {row.count}"
    if row.runs < row.of_runs:
        verdict += f", measured in {row.runs} of {row.of_runs} runs"
    spread = NONE if row.least == row.most else f"{number(row.least)} to {number(row.most)}"
    return row.check.title + unit, number(row.mean), spread, allowed(row), number(row.tolerance), verdict


def allowed(row: FidelityRow) -> str:
    """What mechanics allows, without the tolerance."""
    if row.low is not None and row.high is not None:
        return number(row.low) if row.low == row.high else f"{number(row.low)} to {number(row.high)}"
    if row.high is not None:
        return f"at most {number(row.high)}"
    return f"at least {number(row.low)}" if row.low is not None else "any"


def number(value: float | None) -> str:
    """A number with four digits; a dash for none."""
    return NONE if value is None else f"{value:.4g}"


def remarks(one: Fidelity) -> list[str]:
    """Notes of the checks that were made, and why the others were not: those of one reason share a line."""
    lines = [f"{row.check.title}: {note}" for row in one.rows for note in row.notes]
    reasons: dict[str, list[str]] = {}
    for row in one.of(Verdict.NOT_APPLICABLE):
        reasons.setdefault(row.reason, []).append(row.check.title)
    return [*lines, *(f"not applicable: {', '.join(names)}: {why}" for why, names in reasons.items())]


def _parts(one: Fidelity) -> list[tuple[str, list[FidelityRow]]]:
    """The checks that were made, with a title: those of mechanics, then those of rest; neither where it is empty."""
    told = [row for row in one.rows if row.verdict is not Verdict.NOT_APPLICABLE]
    parts = [
        ("", [row for row in told if row.check.demanded]),
        (_AT_REST, [row for row in told if not row.check.demanded]),
    ]
    return [(title, rows) for title, rows in parts if rows]


def _table(name: str, told: Sequence[FidelityRow]) -> Markup:
    aligned = [Markup(' class="num"') if title in _NUMBERS else Markup("") for title in TITLES]
    columns = zip(aligned, TITLES, strict=True)
    head = Markup("").join(Markup('<th scope="col"{}>{}</th>').format(how, title) for how, title in columns)
    rows = []
    for row in told:
        title, *numbers, verdict = (printable(cell) for cell in cells(row))
        bad = Markup(' class="bad"') if row.verdict is Verdict.BROKEN else Markup("")
        shown = Markup("").join(Markup('<td class="num">{}</td>').format(text) for text in numbers)
        rows.append(
            Markup('<tr><th scope="row">{}</th>{}<td{}>{}</td></tr>\n').format(title, shown, bad, verdict)
        )  # fmt: skip
    return Markup(
        '<div class="scroll" role="region" tabindex="0" aria-label="{}"><table>\n<thead><tr>{}</tr></thead>\n'
        "<tbody>\n{}</tbody></table></div>\n"
    ).format(printable(name), head, Markup("").join(rows))
