"""What the metrics of a group are computed from: its complete runs, and what several metrics need of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.work import HERE, Work
from gpusimbench.evaluator.metrics.identity import distinct_over_time
from gpusimbench.evaluator.metrics.lost_cubes import clamped
from gpusimbench.evaluator.metrics.tosses import LocalErrors, TossErrors, TrackingFloor
from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.results.aggregate import Runs
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.results.sampled import positions, sampled
from gpusimbench.evaluator.runs.state_hashes import side_by_side


@dataclass(frozen=True, eq=False)
class GroupRuns:
    """The complete runs of a group.

    runs       in their order
    reference  that their positions are compared with
    work       where distances are computed
    tosses     errors against measured tosses, one a run, or why there are none
    local      the same from each setting to a measured state on
    moved      positions instead of those at the sample step [m], shape [run, env, item, 2]; None for those
    known      estimates that were made, by the name of their metric
    """

    runs: Runs
    reference: Reference | Missing = Missing("there is no reference")
    work: Work = HERE
    tosses: Sequence[TossErrors | Missing] = ()
    local: Sequence[LocalErrors | Missing] = ()
    moved: NDArray[np.float64] | None = None
    known: dict[str, Any] = field(default_factory=dict)

    @property
    def scene(self) -> str:
        """Its name; empty without a run."""
        return self.runs[0].configuration.scene if self.runs else ""

    @property
    def toss_floor(self) -> TrackingFloor | None:
        """Below which no error of a toss can be; None where the reference has no tosses."""
        reference = self.reference
        return reference.tosses.floor if isinstance(reference, Reference) and reference.tosses else None

    @cached_property
    def at_sample(self) -> Runs:
        """The runs that recorded the sample step; all of them where none did."""
        return sampled(self.runs)

    @cached_property
    def planar(self) -> NDArray[np.float64] | Missing:
        """Planar positions of those runs at the sample step [m], shape [run, env, item, 2]."""
        if self.moved is not None:
            return self.moved
        found, why_not = positions(self.at_sample)
        return Missing(why_not) if found is None else found

    @cached_property
    def classes(self) -> tuple[int, ...]:
        """The class of each of those runs by its bits, numbered in order of first appearance; empty where unknown."""
        found = [r.histories for r in self.at_sample if r.histories]
        both = side_by_side(found) if found and len(found) == len(self.at_sample) else None
        return () if both is None else tuple(distinct_over_time(both[1]).classes.tolist())

    @cached_property
    def on_board(self) -> GroupRuns | Missing:
        """The same with every position beside the board at its nearest edge, those of the reference too.

        Positions, or a reference, that do not move are the very same objects.
        """
        board = self.runs[0].board if self.runs else None
        if board is None or isinstance(self.planar, Missing):
            return Missing("scene.json names no board (a fixed box)")
        moved = clamped(self.planar, board)
        reference = self.reference
        if isinstance(reference, Reference):
            edge = clamped(reference.positions, board)
            if not np.array_equal(edge, reference.positions):
                reference = replace(reference, positions=edge)
        same = np.array_equal(moved, self.planar)
        return replace(self, moved=self.planar if same else moved, reference=reference, known={})
