"""Groups by their error against measured tosses, and who is fast at which error.

A group is *as accurate as the best* where the tosses do not tell its errors of position from those of the most accurate
group. It is *on the front* where no other group is faster, with errors that the tosses do not show to be larger. Who
simulates more time in a second is faster: half the step needs twice the steps.

Errors of tosses are recorded with an environment for each toss, and throughputs with as many environments as fill a
device. How far a cube ends from where it should does not depend on how many others are simulated beside it, unless
gsb-probe says so. So a throughput belongs to the errors of its configuration, whatever the numbers of environments are.
"""

from __future__ import annotations

import statistics
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.results.cost_metrics import FPS, ranked_throughput
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import TOSS_POSITION
from gpusimbench.evaluator.statistics.cases import Paired, paired
from gpusimbench.evaluator.statistics.families import holm

LEVEL = 0.05
"""Adjusted p values below this tell two groups apart."""


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
    return replace(result.group.key, n_env=0, initial="", origins="", warmup=0, timed_steps=0)


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
