"""Variability, regimes and bitwise counts: a row for each group."""

from __future__ import annotations

from gpusimbench.evaluator.metrics.regime import REGIME_MEANING
from gpusimbench.evaluator.report.page.section import Section, Source
from gpusimbench.evaluator.results.clamped_metrics import SUFFIX
from gpusimbench.evaluator.results.group_metrics import W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.metric import Table

_DISTANCES = (W1_PARALLEL.name, W1_RUN_TO_RUN.name, W1_REAL.name)
_LEVELS = {"distinct_envs": "equality_envs", "distinct_runs": "equality_runs"}


def section(source: Source) -> Section:
    """The table of reproducibility, and what its zeros say."""
    folded = [*(name + SUFFIX for name in _DISTANCES), *_LEVELS.values()]
    columns = source.columns(Table.VARIABILITY, folded if source.evaluation.reference else [*folded, W1_REAL.name])
    context = {
        "columns": columns,
        "clamped": {name: name + SUFFIX for name in _DISTANCES},
        "levels": _LEVELS,
        "regimes": REGIME_MEANING,
    }
    return Section("variability", "Variability and regimes", context, link="Variability")
