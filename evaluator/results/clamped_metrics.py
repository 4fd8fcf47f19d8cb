"""W1 with every cube that left the board at the board's edge: what the distances are without its fall and flight.

A cube that falls off the board falls on until the sample step, and engines let it fly for metres: a handful of such
cubes decides a mean over all. Both numbers are shown, the published one first.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.work import Work
from gpusimbench.evaluator.metrics.board import Board, clamped
from gpusimbench.evaluator.results import group_metrics as gm
from gpusimbench.evaluator.results.aggregate import Runs
from gpusimbench.evaluator.results.result import Metric, Reference, not_computed

SUFFIX = "_clamped"
"""Of the name: "w1_parallel_clamped" stands beside "w1_parallel"."""

_HOW = "; positions beside the board are put at its nearest edge"


def clamped_metrics(
    runs: Runs,
    planar: NDArray[np.float64] | None,
    published: tuple[Metric, Metric, Metric],
    reference: Reference | None,
    scene: str,
    work: Work,
) -> list[Metric]:
    """The clamped counterparts of W1 between environments, between runs and to the reference.

    runs       that have positions at the sample step
    planar     their positions [m], [run, env, item, 2]; None without any
    published  the metrics as published, in that order; one that could not be computed has no counterpart either
    """
    board = runs[0].board if runs else None
    if planar is None or board is None:
        return [_none(metric, "this scene has no board") for metric in published]
    moved = clamped(planar, board)
    real = _clamped_reference(reference, board)
    beside = not np.array_equal(moved, planar)
    beside_of_real = beside or (reference is not None and real is not reference)
    parallel, between, gap = published
    return [
        _counterpart(parallel, beside, lambda: gm.parallel(moved, "", work)[0]),
        _counterpart(between, beside, lambda: gm.run_to_run(moved, "", work)[0]),
        _counterpart(gap, beside_of_real, lambda: gm.real(moved, "", real, "", scene, work)),
    ]


def _counterpart(metric: Metric, beside: bool, compute: Callable[[], Metric]) -> Metric:
    """The metric of clamped positions, which is the published one where no position is beside the board."""
    if metric.value is None:
        return _none(metric, metric.why_not)
    found = compute() if beside else metric
    return replace(found, name=metric.name + SUFFIX, method=found.method + _HOW)


def _clamped_reference(reference: Reference | None, board: Board) -> Reference | None:
    if reference is None:
        return None
    moved = clamped(reference.positions, board)
    return reference if np.array_equal(moved, reference.positions) else replace(reference, positions=moved)


def _none(metric: Metric, why: str) -> Metric:
    return not_computed(metric.name + SUFFIX, metric.unit, metric.direction, metric.why_not or why)
