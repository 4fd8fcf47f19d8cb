"""The registry: every metric of an evaluation, in the order of its outputs. All of them iterate over it."""

from __future__ import annotations

from gpusimbench.evaluator.metrics.radar import Axis
from gpusimbench.evaluator.results.cost_metrics import COSTS
from gpusimbench.evaluator.results.group_metrics import (
    CLAMPED,
    LEFT_BOARD,
    REGIME,
    SANK,
    W1_PARALLEL,
    W1_REAL,
    W1_RUN_TO_RUN,
)
from gpusimbench.evaluator.results.identity_metrics import (
    CAPTURE_CHANGES_STATES,
    DISTINCT_ENVS,
    DISTINCT_RUNS,
    DIVERGENCE_RATE,
    EQUALITY_ENVS,
    EQUALITY_RUNS,
)
from gpusimbench.evaluator.results.joint_metrics import JOINT_METRICS
from gpusimbench.evaluator.results.metric import Metric, Table
from gpusimbench.evaluator.results.toss_metrics import TOSS_LOCAL_METRICS, TOSS_METRICS

METRICS: dict[str, Metric] = {
    metric.name: metric
    for metric in (
        *COSTS,
        W1_PARALLEL,
        W1_RUN_TO_RUN,
        W1_REAL,
        *CLAMPED,
        *JOINT_METRICS,
        DISTINCT_ENVS,
        DISTINCT_RUNS,
        EQUALITY_ENVS,
        EQUALITY_RUNS,
        DIVERGENCE_RATE,
        LEFT_BOARD,
        SANK,
        REGIME,
        CAPTURE_CHANGES_STATES,
        *TOSS_METRICS,
        *TOSS_LOCAL_METRICS,
    )
}
"""By name."""


def of_table(table: Table) -> list[Metric]:
    """The metrics that are columns of a table of the report."""
    return [metric for metric in METRICS.values() if metric.table is table]


def on_radar(axis: Axis) -> Metric | None:
    """The metric that an axis of the radar shows; None of the largest number of environments, which is of a sweep."""
    return next((metric for metric in METRICS.values() if metric.radar is axis), None)
