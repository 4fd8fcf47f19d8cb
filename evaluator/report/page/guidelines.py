"""Which group for which need, each with its rule."""

from __future__ import annotations

from gpusimbench.evaluator.report.page.section import Section, Source


def section(source: Source) -> Section:
    """The picks."""
    return Section("guidelines", "Guidelines", {})
