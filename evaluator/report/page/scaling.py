"""Throughput and memory against the number of environments."""

from __future__ import annotations

from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.report.scaling import scene_sweeps


def section(source: Source) -> Section:
    """Curves, how far each goes and why, and every point."""
    return Section("scaling", "Scaling", {"sweeps": list(scene_sweeps(source.evaluation.sweeps))})
