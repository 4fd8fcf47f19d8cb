"""Errors of a thrown cube against measured tosses: metrics, groups by their error, and who is fast at which error.

A group is *as accurate as the best* where the tosses do not tell its errors of position from those of the most accurate
group. It is *on the front* where no other group is faster, with errors that the tosses do not show to be larger. Who
simulates more time in a second is faster: half the step needs twice the steps.

Errors of tosses are recorded with an environment for each toss, and throughputs with as many environments as fill a
device. How far a cube ends from where it should does not depend on how many others are simulated beside it, unless
gsb-probe says so. So a throughput belongs to the errors of its configuration, whatever the numbers of environments are.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from gpusimbench.evaluator.metrics.tosses import LocalErrors, TossErrors
from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.results.cost_metrics import FPS, ranked_throughput
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.group_runs import GroupRuns
from gpusimbench.evaluator.results.metric import Direction, Estimate, Metric, Table
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.statistics.cases import DRAWS, Paired, mean_interval, paired
from gpusimbench.evaluator.statistics.families import holm

_INTERVAL = "tosses resampled"
_CM, _MM, _MJ = 100.0, 1000.0, 1000.0
_DEGREES = 180.0 / math.pi


_Errors = TypeVar("_Errors", TossErrors, LocalErrors)

LEVEL = 0.05
"""Adjusted p values below this tell two groups apart."""


def _errors_of_runs(of_runs: Sequence[_Errors | Missing]) -> list[_Errors] | Missing:
    """Errors of the runs that have any, or why none has."""
    found = [errors for errors in of_runs if not isinstance(errors, Missing)]
    reasons = [errors.reason for errors in of_runs if isinstance(errors, Missing)]
    return found or Missing(reasons[0] if reasons else "no run of this group is complete")


def _mean_of(field: str, factor: float) -> Callable[[Metric, GroupRuns], Estimate | Missing]:
    """The mean over runs and tosses of a field of TossErrors, in the unit of the metric."""

    def estimate(metric: Metric, group: GroupRuns) -> Estimate | Missing:
        found = _errors_of_runs(group.tosses)
        if isinstance(found, Missing):
            return found
        per_toss = np.mean([getattr(errors, field) for errors in found], axis=0) * factor
        floor = group.toss_floor
        floors = {"position": floor.position, "rotation": floor.rotation} if floor else {}
        return Estimate(
            metric,
            float(per_toss.mean()),
            method=f"{metric.method}, mean over tosses and runs; interval: {_INTERVAL}, {DRAWS} draws with seed 0",
            n=len(per_toss),
            ci95=mean_interval(per_toss),
            details=OverTosses(
                per_run=tuple(float(getattr(errors, field).mean() * factor) for errors in found),
                tosses=len(per_toss),
                tracking_floor=floors[field] * factor if field in floors else None,
                per_toss=tuple(per_toss.tolist()),
                numbers=tuple(found[0].numbers.tolist()),
            ),
        )

    return estimate


def _local(field: str, factor: float) -> Callable[[Metric, GroupRuns], Estimate | Missing]:
    """The mean over runs and tosses of a field of LocalErrors, in the unit of the metric."""

    def estimate(metric: Metric, group: GroupRuns) -> Estimate | Missing:
        found = _errors_of_runs(group.local)
        if isinstance(found, Missing):
            return found
        of_runs = np.array([getattr(errors, field) for errors in found]) * factor
        long_enough = np.isfinite(of_runs[0])
        per_toss = of_runs[:, long_enough].mean(axis=0)
        rows, floor = found[0].rows, float(getattr(found[0].floor, field)) * factor
        return Estimate(
            metric,
            float(per_toss.mean()),
            method=f"{metric.method}, then over tosses and runs; k = {rows}; interval: {_INTERVAL}, {DRAWS} draws "
            "with seed 0",
            n=len(per_toss),
            ci95=mean_interval(per_toss),
            details=OverTosses(
                per_run=tuple(float(run[long_enough].mean()) for run in of_runs),
                tosses=len(per_toss),
                tracking_floor=None if math.isnan(floor) else floor,
                per_toss=tuple(per_toss.tolist()),
                rows=rows,
            ),
        )

    return estimate


TOSS_POSITION = Metric(
    "toss_position", "error of position", "cm", Direction.LOWER,
    "thrown cube ([how to](how-to/cube-toss.md)): distance between the simulated and the measured centre, mean over "
    "the measured rows (points in time) of a toss after the first row, then over tosses. `tracking_floor`: the same "
    "distance for a cube in free fall before the first contact; no simulation can be closer to the measurement",
    method="distance from the simulated centre to the toss's, mean over the rows of a toss", table=Table.REALITY,
    of_group=_mean_of("position", _CM), interval=_INTERVAL, optional=True,
)  # fmt: skip

TOSS_ROTATION = Metric(
    "toss_rotation", "error of rotation", "deg", Direction.LOWER,
    "angle of the rotation from the measured to the simulated orientation, mean as for `toss_position`",
    method="angle from the simulated orientation to the toss's, mean over the rows of a toss", table=Table.REALITY,
    of_group=_mean_of("rotation", _DEGREES), interval=_INTERVAL, optional=True,
)  # fmt: skip

TOSS_END_POSITION = replace(
    TOSS_POSITION, name="toss_end_position", title="error of position at the end",
    docs="distance between the centres at the last measured row of each toss that the run recorded (see `--stride`)",
    method="distance from the simulated centre to the toss's at its last row",
    of_group=_mean_of("end_position", _CM),
)  # fmt: skip

TOSS_END_ROTATION = replace(
    TOSS_ROTATION, name="toss_end_rotation", title="error of rotation at the end",
    docs="angle between the orientations at the same row",
    method="angle from the simulated orientation to the toss's at its last row",
    of_group=_mean_of("end_rotation", _DEGREES),
)  # fmt: skip

TOSS_FACE = replace(
    TOSS_POSITION, name="toss_face", title="same face up", unit="%", direction=Direction.HIGHER,
    docs="share of tosses that end with the same face up as measured; guessing gives 1 in 6",
    method="tosses whose simulation ends with the same face up", of_group=_mean_of("end_face", 100.0),
)  # fmt: skip

TOSS_REST = replace(
    TOSS_POSITION, name="toss_rest", title="error of time to rest", unit="s", direction=Direction.NEITHER,
    docs="time after which the cube stays slower than 3 cm/s and 0.3 rad/s, minus that of the measured toss; if the "
    "simulated cube still moves at the last measured row, the time of that row is used, a lower bound",
    method="time to rest less that of the toss", of_group=_mean_of("rest_time", 1.0),
)  # fmt: skip

TOSS_ENERGY = replace(
    TOSS_POSITION, name="toss_energy", title="error of energy", unit="mJ",
    docs="absolute difference of the mechanical energies of a uniform cube, mean as for `toss_position`",
    method="difference of the simulated mechanical energy from the toss's, absolute, mean over the rows of a toss",
    of_group=_mean_of("energy", _MJ),
)  # fmt: skip

TOSS_DEPTH = replace(
    TOSS_POSITION, name="toss_depth", title="deepest penetration", unit="mm",
    docs="largest depth of a corner below the table at any row of a toss",
    method="deepest place of a corner below the table at any row of a toss", of_group=_mean_of("depth", _MM),
)  # fmt: skip

TOSS_LOCAL_POSITION = replace(
    TOSS_POSITION, name="toss_local_position", title="local error of position",
    docs="of recordings with `--intervene teacher@STEPS`: the cube is set to each k-th measured row, so that early "
    "errors are no part of later ones. Distance between the centres k rows later, just before the next setting; mean "
    "over the settings of a toss, then over tosses with more than k rows. `tracking_floor`: the same for a cube in "
    "free flight, over the settings with k rows of it",
    method="distance between the centres k rows after the cube was set to a row of the toss, mean over a toss",
    of_group=_local("position", _CM),
)  # fmt: skip

TOSS_LOCAL_ROTATION = replace(
    TOSS_LOCAL_POSITION, name="toss_local_rotation", title="local error of rotation", unit="deg",
    docs="angle between the orientations k rows after a setting, as for `toss_local_position`",
    method="angle between the orientations k rows after the cube was set to a row of the toss, mean over a toss",
    of_group=_local("rotation", _DEGREES),
)  # fmt: skip

TOSS_METRICS = (
    TOSS_POSITION, TOSS_ROTATION, TOSS_END_POSITION, TOSS_END_ROTATION, TOSS_FACE, TOSS_REST, TOSS_ENERGY, TOSS_DEPTH,
)  # fmt: skip
"""Of whole tosses."""

TOSS_LOCAL_METRICS = (TOSS_LOCAL_POSITION, TOSS_LOCAL_ROTATION)
"""Of tosses that are set to measured states on the way."""


@dataclass(frozen=True)
class Ranked:
    """A group that was compared with measured tosses.

    error     of position [cm], mean over the tosses that all groups are judged by, or over its own where there are none
    against   of its errors of position with those of the most accurate group, over the tosses that both are judged by;
              None of that group, and where there are no such tosses
    adjusted  p value after Holm's adjustment for all groups
    first     the most accurate group
    timed     the group of the same configuration with a throughput; of several, that of the most environments
    """

    result: GroupResult
    error: float
    against: Paired | None
    adjusted: float | None
    first: GroupResult
    timed: GroupResult | None

    @property
    def fps(self) -> float:
        """Throughput of its configuration [env-steps/s]; 0 where none was timed."""
        return _fps(self.timed) if self.timed else 0.0

    @property
    def pace(self) -> float:
        """Simulated time of all environments in a time [s/s]."""
        return self.fps * self.timed.group.key.dt if self.timed else 0.0

    @property
    def with_throughput(self) -> GroupResult:
        """The group with the throughput of its configuration beside its own errors."""
        if self.timed is None:
            return self.result
        return replace(self.result, metrics={**self.result.metrics, FPS.name: self.timed.metrics[FPS.name]})

    @property
    def less_accurate(self) -> str:
        """Why it is not as accurate as the best, in words; empty where the tosses do not tell the two apart."""
        if self.result is self.first:
            return ""
        if self.against is None or self.adjusted is None:
            return f"not compared with the same tosses as {self.first.label}"
        if self.adjusted >= LEVEL:
            return ""
        more = f"{self.against.mean:.2g} cm larger than that of {self.first.label}"
        return f"less accurate: error of position {more}, p = {self.adjusted:.2g}"


def configuration(result: GroupResult) -> Hashable:
    """What a group has in common with those that differ from it in the number of environments alone."""
    key = result.group.key.with_settings(initial="")
    return replace(key, n_env=0, origins="", warmup=0, timed_steps=0)


def ranked(results: Sequence[GroupResult], timed: Sequence[GroupResult] = ()) -> list[Ranked]:
    """Groups with errors against tosses, the smallest mean error of position first.

    A group whose options were fitted is judged by odd tosses; then all are ranked by these.

    timed  further groups, whose throughputs may belong to these errors
    """
    found = {r.label: errors_by_toss(r) for r in results if known(r.metrics[TOSS_POSITION.name].value) is not None}
    if not found:
        return []
    shared = set.intersection(*(set(errors) for errors in found.values()))
    error = {
        label: statistics.fmean(value for toss, value in errors.items() if not shared or toss in shared)
        for label, errors in found.items()
    }
    order = sorted((r for r in results if r.label in found), key=lambda r: error[r.label])
    first = order[0]
    compared = {}
    for result in order[1:]:
        one, other = found[result.label], found[first.label]
        if both := sorted(one.keys() & other.keys()):
            compared[result.label] = paired([one[toss] for toss in both], [other[toss] for toss in both])
    adjusted = dict(zip(compared, holm([one.p_value for one in compared.values()]), strict=True))
    clocked = sorted((r for r in (*results, *timed) if _fps(r)), key=lambda r: r.group.key.n_env)
    beside = {configuration(r): r for r in clocked}
    return [
        Ranked(r, error[r.label], compared.get(r.label), adjusted.get(r.label), first, beside.get(configuration(r)))
        for r in order
    ]


def beaten_by(order: Sequence[Ranked]) -> dict[str, str]:
    """By label, of the groups with a throughput, the fastest group that beats it; empty on the
    front."""
    timed = [one for one in order if one.timed]

    def beats(other: Ranked, one: Ranked) -> bool:
        if other.pace == one.pace:
            return other.error < one.error
        return other.pace > one.pace and (other.error <= one.error or _alike(other.result, one.result))

    found = {}
    for one in timed:
        better = [other for other in timed if beats(other, one)]
        found[one.result.label] = max(better, key=lambda other: other.pace).result.label if better else ""
    return found


def _alike(one: GroupResult, other: GroupResult) -> bool:
    # whether the tosses do not tell the errors of two groups apart
    errors = (errors_by_toss(one), errors_by_toss(other))
    both = sorted(errors[0].keys() & errors[1].keys())
    return bool(both) and paired(*([of[toss] for toss in both] for of in errors)).p_value >= LEVEL


def _fps(result: GroupResult) -> float:
    return ranked_throughput(result.metrics[FPS.name])


def errors_by_toss(result: GroupResult) -> dict[int, float]:
    """Errors of position [cm] by the number of the toss."""
    details = result.metrics[TOSS_POSITION.name].of(OverTosses)
    return dict(zip(details.numbers, details.per_toss, strict=True))
