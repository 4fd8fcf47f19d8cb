"""What the metrics of a group are computed from: its complete runs, and those that recorded the sample step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.work import HERE, Work
from gpusimbench.evaluator.metrics.density import Density
from gpusimbench.evaluator.metrics.identity import distinct_over_time
from gpusimbench.evaluator.metrics.lost_cubes import clamped
from gpusimbench.evaluator.metrics.tosses import LocalErrors, TossErrors, TrackingFloor
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.results.aggregate import NO_RUN, Runs
from gpusimbench.evaluator.runs.positions import NO_JOINTS, JointSample
from gpusimbench.evaluator.runs.state_hashes import side_by_side
from gpusimbench.evaluator.runs.toss_motion import MeasuredTosses
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.location import Place


def sampled(runs: Runs) -> Runs:
    """The runs that recorded the sample step; all of them where none did."""
    return tuple(run for run in runs if run.reached) or tuple(runs)


def positions(runs: Runs) -> tuple[NDArray[np.float64] | None, str]:
    """Planar positions of all runs [m], [run, env, item, 2]; or None and the reason."""
    if why_not := no_positions(runs):
        return None, why_not
    return np.stack([r.positions.planar for r in runs if r.positions]), ""


def no_positions(runs: Runs) -> str:
    """Why not all runs have positions at the sample step, with the names of those; empty where all have."""
    if not runs:
        return NO_RUN
    why = next((why for run in runs if (why := why_missing(run.positions))), "")
    alike = [run for run in runs if why_missing(run.positions) == why]
    return why if len(alike) == len(runs) or not why else f"{named(alike)}: {why}"


def left_out(runs: Runs) -> list[str]:
    """A sentence for each reason why runs are not among the sampled ones."""
    used = sampled(runs)
    reached = {id(run) for run in used}
    found = gathered((why_missing(run.positions), at) for at, run in enumerate(runs) if id(run) not in reached)
    others = "run" if len(used) == 1 else f"{len(used)} runs"
    return [
        f"{named([runs[at] for at in places])} left out of W1, equality, published type and bodies off the board, "
        f"which are those of the other {others}: {why}"
        for why, places in found.items()
    ]


def ends_early(runs: Runs) -> list[str]:
    """Sentences on runs that captured fewer steps than others: how far their bits are compared."""
    last = [int(run.histories.steps[-1]) if run.histories else None for run in runs]
    latest = max((step for step in last if step is not None), default=None)
    if latest is None:
        return []
    notes = []
    for step in sorted({step for step in last if step is not None and step < latest}):
        short = [run for run, end in zip(runs, last, strict=True) if end == step]
        notes.append(
            f"{named(short)} captured up to step {step} and others up to step {latest}: bits of two runs are compared "
            "at the steps that both captured"
        )
    if without := [run for run, end in zip(runs, last, strict=True) if end is None]:
        notes.append(f"{named(without)} captured no states: no bits to compare")
    return notes


def named(runs: Runs) -> str:
    """Runs by index and file: "run 2 (a.mcap)", "runs 2 (a.mcap), 3 (b.mcap)"."""
    parts = [f"{run.configuration.run_index} ({run.path.name})" for run in runs]
    return f"run{'' if len(parts) == 1 else 's'} {', '.join(parts)}"


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


@dataclass(frozen=True)
class Reference:
    """The positions and joints that simulations are compared with.

    label      what they are
    path       of the recording
    run_id     of the recording
    measured   True for real trials, False for another simulation
    scene      that they belong to
    positions  [m], shape [trial, item, 2]; no item where it has joints alone
    density    on the shared grid
    tosses     measured motions of a thrown cube; None where it has none
    joints     at the sample step, or why there are none
    """

    label: str
    path: Place
    run_id: str
    measured: bool
    scene: str
    positions: NDArray[np.float64]
    density: Density | None = None
    tosses: MeasuredTosses | None = None
    joints: JointSample | Missing = NO_JOINTS
