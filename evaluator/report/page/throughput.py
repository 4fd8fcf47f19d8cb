"""Throughput and memory at one number of environments: a row for each group."""

from __future__ import annotations

from evaluator.report.page.section import Section, Source


def section(source: Source) -> Section:
    """The table; sweeps have a section of their own."""
    return Section("throughput", "Throughput and memory", {})
