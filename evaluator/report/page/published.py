"""The paper's figures, marked as the paper's."""

from __future__ import annotations

from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.report.scaling import beside_published
from gpusimbench.evaluator.results import published


def section(source: Source) -> Section | None:
    """None where they were not asked for."""
    if not source.published:
        return None
    beside = list(beside_published(source.evaluation.sweeps))
    return Section("published", "Published figures", {"paper": published, "beside": beside})
