"""Throughput, memory and times at one number of environments: a row for each group."""

from __future__ import annotations

from gpusimbench.evaluator.report import timed
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results.metric import Table

_FOLDED = ("process_memory_peak",)
"""Metrics that stand in the cell of another."""


def section(source: Source) -> Section:
    """The table; sweeps have a section of their own."""
    scenes = dict.fromkeys(r.group.key.scene for r in source.shown)
    notes = [(scene, timed.remarks(r for r in source.shown if r.group.key.scene == scene)) for scene in scenes]
    columns = source.columns(Table.THROUGHPUT, _FOLDED)
    return Section("throughput", "Throughput and memory", {"notes": notes, "columns": columns})
