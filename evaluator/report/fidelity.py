"""Checks of mechanics in words, and as JSON."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

from gpusimbench.evaluator.json_values import picked
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.results.fidelity import Fidelity, FidelityRow, Verdict
from gpusimbench.schemas.text import plural

TITLES = ("check", "measured", "range", "allowed", "tolerance", "verdict")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def fidelity_record(one: Fidelity) -> dict[str, Any]:
    """One group's physics for JSON: every check by its key, with its verdict."""
    of_group = "label scene runs n_env looked_at exactness why_not revision held checkable not_checkable"
    return {**picked(one, of_group), "checks": {row.check.key: _check(row) for row in one.rows}}


def _check(row: FidelityRow) -> dict[str, Any]:
    record = {**picked(row.check, "title unit demanded"), **picked(row, "verdict reason")}
    if row.verdict is Verdict.NOT_APPLICABLE:
        return record
    values = picked(row, "mean least most runs count low high tolerance broken of_runs")
    return {**record, **values, "tolerance_formula": row.of, "notes": list(row.notes)}


def cells(row: FidelityRow) -> tuple[str, ...]:
    """A measured check as the texts of a table's row, in the order of its titles."""
    unit = f" [{row.check.unit}]" if row.check.unit else ""
    verdict = row.verdict.value.upper() if row.verdict is Verdict.BROKEN else row.verdict.value
    if row.broken:
        verdict += f" {row.broken} of {row.count}"
    if row.runs < row.of_runs:
        verdict += f", measured in {row.runs} of {plural(row.of_runs, 'run')}"
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
    """Notes of the checks that were made, and why the others were not: what several checks have is said once."""
    noted: dict[str, list[str]] = {}
    for row in one.rows:
        for note in _in_ranges(row.notes):
            noted.setdefault(note, []).append(row.check.title)
    lines = [f"{', '.join(titles)}: {note}" for note, titles in noted.items()]
    reasons: dict[str, list[str]] = {}
    for row in one.of(Verdict.NOT_APPLICABLE):
        reasons.setdefault(row.reason, []).append(row.check.title)
    return [*lines, *(f"not applicable: {', '.join(names)}: {why}" for why, names in reasons.items())]


def _in_ranges(notes: Sequence[str]) -> Iterator[str]:
    """Notes of several runs that differ in their numbers alone as one, each number as the range that it takes."""
    alike: dict[str, list[list[str]]] = {}
    for note in notes:
        alike.setdefault(_NUMBER.sub("{}", note.replace("{", "(").replace("}", ")")), []).append(_NUMBER.findall(note))
    for words, found in alike.items():
        ranges = (sorted(set(numbers), key=float) for numbers in zip(*found, strict=True))
        yield words.format(*(values[0] if len(values) == 1 else f"{values[0]} to {values[-1]}" for values in ranges))
