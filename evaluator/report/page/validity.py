"""What shows that the steps did their work."""

from __future__ import annotations

from gpusimbench.evaluator.report.page.section import Section, Source


def section(source: Source) -> Section:
    """Counts, buffers, overflow and actions of every group."""
    return Section("validity", "Validity", {})
