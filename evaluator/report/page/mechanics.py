"""What states say of mechanics."""

from __future__ import annotations

from gpusimbench.evaluator.report.fidelity import fidelity_html
from gpusimbench.evaluator.report.page.section import Section, Source


def section(source: Source) -> Section:
    """Every check of every group."""
    return Section("mechanics", "Mechanics", {"physics": fidelity_html([r.fidelity for r in source.shown])})
