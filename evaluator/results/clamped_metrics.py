"""W1 with every cube that left the board at the board's edge: what the distances are without its fall and flight.

A cube that falls off the board falls on until the sample step, and engines let it fly for metres: a handful of such
cubes decides a mean over all. Both numbers are shown, the published one first.
"""

from __future__ import annotations

from dataclasses import replace

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.details import BetweenEnvs, BetweenRuns, Details
from gpusimbench.evaluator.results.group_metrics import W1_PARALLEL, W1_REAL, W1_RUN_TO_RUN
from gpusimbench.evaluator.results.group_runs import GroupRuns
from gpusimbench.evaluator.results.metric import Estimate, Metric

SUFFIX = "_clamped"
"""Of the name: "w1_parallel_clamped" stands beside "w1_parallel"."""

_HOW = "; positions beside the board are put at its nearest edge"


def _clamped(published: Metric) -> Metric:
    """The counterpart of a metric, which has its very value where no position is beside the board."""

    def estimate(metric: Metric, group: GroupRuns) -> Estimate | Missing:
        found, board = published.estimate(group), group.on_board
        if isinstance(found.value, Missing):
            return found.value
        if isinstance(board, Missing):
            return board
        beside = board.planar is not group.planar or (published is W1_REAL and board.reference is not group.reference)
        if beside:
            found = published.estimate(board)
            found = replace(found, details=_without_matrix(found.details))
        return replace(found, metric=metric, method=found.method + _HOW)

    return replace(
        published,
        name=published.name + SUFFIX,
        title=f"clamped {published.title}",
        docs=f"`{published.name}` with every position beside the board [moved to its nearest "
        "edge](#cubes-that-left-the-board)",
        published=False,
        values=None,
        of_group=estimate,
        optional=True,
        axis=None,
        radar=None,
    )


def _without_matrix(details: Details) -> Details:
    # the matrices that are kept are those of the published values
    if isinstance(details, BetweenEnvs):
        return replace(details, matrix_of=None, matrix_cm=None)
    if isinstance(details, BetweenRuns):
        return replace(details, run_indices=None, classes=None, matrix_cm=None)
    return details


CLAMPED = tuple(_clamped(metric) for metric in (W1_PARALLEL, W1_RUN_TO_RUN, W1_REAL))
"""The clamped counterparts of W1 between environments, between runs and to the reference."""
