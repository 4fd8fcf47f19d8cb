"""Every file, with what it is and its content hash."""

from __future__ import annotations

from gpusimbench.evaluator.report.page.section import Section, Source


def section(source: Source) -> Section:
    """The list of files."""
    recordings = [(r.label, one) for r in source.evaluation.results for one in r.group.recordings]
    return Section("recordings", "Recordings", {"recordings": recordings})
