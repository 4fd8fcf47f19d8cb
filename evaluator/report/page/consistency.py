"""Distances between the environments of a run, and between runs, pair by pair."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from evaluator.report.figures import matrix
from evaluator.report.page.picture import Picture
from evaluator.report.page.section import Section, Source
from evaluator.results import GroupResult


def section(source: Source) -> Section:
    """The matrices of every group."""
    context = {
        "parallel_matrices": [_matrix(r, r.parallel_matrix, "env", "w1_parallel") for r in source.shown],
        "run_matrices": [_matrix(r, r.run_matrix, "run", "w1_run_to_run") for r in source.shown],
        "hatch": Markup(matrix.hatch()),
    }
    return Section("consistency", "Consistency matrices", context)


def _matrix(result: GroupResult, values: NDArray[np.float64] | None, of: str, name: str) -> Picture:
    if values is None:
        metric = result.metrics.get(name)
        why_not = (metric.why_not or metric.extra.get("no_matrix")) if metric else ""
        why_not = why_not or "it was not computed"
        return Picture(result.label, f"No matrix: {why_not}.", None)
    svg = Markup(matrix.matrix_map(values, of=of, name=result.label))
    return Picture(result.label, matrix.caption(values, of=of), svg)
