"""What the metrics of a group are computed from: its complete runs, those that recorded the sample step, and how values
of runs become one: mean or median, SD and interval."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.compute.work import HERE, Work
from gpusimbench.evaluator.metrics.identity import distinct_over_time
from gpusimbench.evaluator.metrics.lost_cubes import clamped
from gpusimbench.evaluator.metrics.throughput import typical_time
from gpusimbench.evaluator.metrics.tosses import LocalErrors, TossErrors, TrackingFloor
from gpusimbench.evaluator.missing import Missing, why_missing
from gpusimbench.evaluator.results.reference import Reference
from gpusimbench.evaluator.runs.run import Run
from gpusimbench.evaluator.runs.state_hashes import side_by_side
from gpusimbench.evaluator.statistics.jackknife import Interval, jackknife_mean
from gpusimbench.schemas.gathering import gathered

NO_RUN = "no run of this group is complete"
"""Why a group has no value."""

_MIN_RUNS = 3  # for an interval
_ROUNDING = 1e-12  # of a value

Runs = Sequence[Run]


@dataclass(frozen=True)
class Aggregate:
    """One value of several runs.

    value   in the unit of the runs' values
    sd      standard deviation of a sample; None for one run, and where none is meant
    ci95    95 % interval, or why there is none; None where no interval is meant
    method  how the interval was obtained
    """

    value: float
    sd: float | None = None
    ci95: tuple[float, float] | Missing | None = None
    method: str = ""


@dataclass(frozen=True)
class Aggregator:
    """Makes one value of the values of runs.

    name      "mean" or "median"
    interval  what the interval is, for the documentation; empty where there is none
    """

    name: str
    interval: str
    of: Callable[[Sequence[float]], Aggregate]


def mean_of(values: Sequence[float]) -> Aggregate:
    """The mean of nonnegative values, one a run, with SD and a jackknife interval."""
    found = np.array(values)
    spread = differ(found)
    interval = jackknife_mean(found) if len(found) >= _MIN_RUNS else None
    bounds = ends_of(interval, len(found), spread=spread)
    # equal values have their very value for a mean, and no deviation: sums of them round
    return Aggregate(
        float(np.mean(values)) if spread else values[0],
        sd=(float(np.std(values, ddof=1)) if spread else 0.0) if len(found) > 1 else None,
        ci95=bounds,
        method=interval.method if bounds and interval else "",
    )


def median_of(values: Sequence[float]) -> Aggregate:
    """The median, without SD and interval."""
    return Aggregate(typical_time(values))


MEAN = Aggregator("mean", "delete-one-run jackknife", mean_of)
MEDIAN = Aggregator("median", "", median_of)


def differ(values: NDArray[np.float64]) -> bool:
    """Whether values are apart by more than the rounding of what they are computed from."""
    return bool(np.ptp(values) > _ROUNDING * np.abs(values).max()) if values.size else False


def ends_of(interval: Interval | None, runs: int, *, spread: bool) -> tuple[float, float] | Missing:
    """The interval's ends, or why there are none; `spread` says whether the runs differ at all."""
    if runs < _MIN_RUNS or interval is None:
        return Missing(f"needs at least {_MIN_RUNS} runs")
    if not spread:
        # an interval of width zero would claim that rare differences are excluded
        return Missing(f"no spread in {runs} runs")
    return interval.ci95


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
