"""Groups by their error against measured tosses, and who is fast at which error.

A group is *as accurate as the best* where the tosses do not tell its errors of position from those of the most accurate
group. It is *on the front* where no other group is both at least as fast and at least as accurate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.results.cost_metrics import FPS
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

    against   of its errors of position with those of the most accurate group; None of that group, and where the two
              were not compared with the same tosses
    adjusted  p value after Holm's adjustment for all groups
    first     the most accurate group
    """

    result: GroupResult
    against: Paired | None
    adjusted: float | None
    first: GroupResult

    @property
    def error(self) -> float:
        """Mean error of position [cm]."""
        return known(self.result.metrics[TOSS_POSITION.name].value) or 0.0

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


def ranked(results: Sequence[GroupResult]) -> list[Ranked]:
    """Groups with errors against tosses, the smallest mean error of position first."""
    found = [r for r in results if known(r.metrics[TOSS_POSITION.name].value) is not None]
    found.sort(key=lambda r: known(r.metrics[TOSS_POSITION.name].value) or 0.0)
    if not found:
        return []
    first = _per_toss(found[0])
    compared = {
        r.label: paired(_per_toss(r), first) for r in found[1:] if len(_per_toss(r)) == len(first)
    }  # fmt: skip
    adjusted = dict(zip(compared, holm([one.p_value for one in compared.values()]), strict=True))
    return [Ranked(r, compared.get(r.label), adjusted.get(r.label), found[0]) for r in found]


def beaten_by(order: Sequence[Ranked]) -> dict[str, str]:
    """By label, of the groups with a throughput, the fastest group that is faster and no less accurate; empty on the
    front."""
    timed = [one for one in order if known(one.result.metrics[FPS.name].value) is not None]

    def beats(other: Ranked, one: Ranked) -> bool:
        gains = (_fps(other) - _fps(one), one.error - other.error)
        return min(gains) >= 0 and max(gains) > 0

    found = {}
    for one in timed:
        better = [other for other in timed if beats(other, one)]
        found[one.result.label] = max(better, key=_fps).result.label if better else ""
    return found


def _fps(one: Ranked) -> float:
    return known(one.result.metrics[FPS.name].value) or 0.0


def _per_toss(result: GroupResult) -> tuple[float, ...]:
    found = result.metrics[TOSS_POSITION.name]
    return () if isinstance(found.value, Missing) else found.of(OverTosses).per_toss
