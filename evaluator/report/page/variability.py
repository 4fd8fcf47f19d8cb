"""Variability, regimes and bitwise counts: a row for each group."""

from __future__ import annotations

from gpusimbench.evaluator.metrics.regime import REGIME_MEANING
from gpusimbench.evaluator.report.page.section import Section, Source


def section(source: Source) -> Section:
    """The table of reproducibility, and what its zeros say."""
    reference = source.evaluation.reference
    compared = "EMD to real trials" if reference and reference.measured else "EMD to the reference"
    return Section("variability", "Variability and regimes", {"real_title": compared, "regimes": REGIME_MEANING},
                   link="Variability")  # fmt: skip
