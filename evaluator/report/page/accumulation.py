"""Variability against the number of environments."""

from __future__ import annotations

from gpusimbench.evaluator.report import accumulation
from gpusimbench.evaluator.report.page.section import Section, Source


def section(source: Source) -> Section | None:
    """None without a sweep that captured states."""
    found = source.evaluation.accumulation
    if not found:
        return None
    shown = [(one, list(accumulation.rows(one)), accumulation.remarks(one)) for one in found]
    title = "Variability against the number of environments"
    return Section("accumulation", title, {"accumulation": shown, "titles": accumulation.TITLES}, link="Accumulation")
