"""Errors against measured tosses: a row for each group, the most accurate first, each compared with the first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import EMPTY, Block, Cell, Column, Section, Text
from gpusimbench.evaluator.render.numbers import figure, plural
from gpusimbench.evaluator.report.sections.rows import Reasons
from gpusimbench.evaluator.report.sections.values import Written, column_of, of_groups
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.metric import Table
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import TOSS_POSITION, TOSS_ROTATION
from gpusimbench.evaluator.statistics.cases import Paired, paired
from gpusimbench.evaluator.statistics.families import holm

_LEGEND = (
    "Each simulated toss is compared with the measured toss from whose first state it began, at the measured rows.",
    "95 % intervals: tosses resampled.",
    "more than the first: mean over tosses of the error less that of the first group, toss by toss; p: sign-flip "
    "permutation test, adjusted by Holm's method for all rows; visible: the smallest difference that these tosses show "
    "with 95 % probability",
)


@dataclass(frozen=True)
class Ranked:
    """A group that was compared with measured tosses.

    against   of its errors of position with those of the most accurate group; None of that group, and where the two
              were not compared with the same tosses
    adjusted  p value after Holm's adjustment for all groups
    """

    result: GroupResult
    against: Paired | None
    adjusted: float | None


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
    return [Ranked(r, compared.get(r.label), adjusted.get(r.label)) for r in found]


def section(source: Source) -> Section | None:
    """None where nothing was compared with tosses."""
    order = ranked(source.shown)
    if not order:
        return None
    best = order[0].result
    reasons = Reasons()
    metrics = source.columns(Table.REALITY)
    columns = [column_of(metric, reasons) for metric in metrics]
    columns.insert(1, _more_than_first(order))
    blocks: list[Block] = [
        of_groups("tosses", "Errors against measured tosses", [one.result for one in order], columns, reasons, _LEGEND),
        Text(_floor(best)),
    ]
    error = known(best.metrics[TOSS_POSITION.name].value) or 0.0
    said = f"{plural(len(order), 'group')}; smallest error of position: {best.label}, {figure(error, 'cm')} cm"
    return Section("tosses", "Accuracy: measured tosses", tuple(blocks), said, folded=True)


def _more_than_first(order: Sequence[Ranked]) -> tuple[Column, Written]:
    found = {one.result.label: one for one in order}

    def cell(result: GroupResult) -> Cell:
        one = found[result.label]
        if one.against is None or one.adjusted is None:
            return EMPTY
        low, high = one.against.ci95 or (None, None)
        span = "" if low is None or high is None else f"[{figure(low, 'cm')}, {figure(high, 'cm')}]"
        p = "p < 0.001" if one.adjusted < 0.001 else f"p = {one.adjusted:.2g}"
        visible = f"visible from {figure(one.against.visible, 'cm')}"
        return Cell(figure(one.against.mean, "cm"), one.against.mean, one.against.ci95, span, (p, visible))

    return Column("more than the first [cm]", "error of position less that of the first row, toss by toss"), cell


def _floor(result: GroupResult) -> str:
    """What the measurement itself leaves."""
    parts = []
    for metric in (TOSS_POSITION, TOSS_ROTATION):
        floor = result.metrics[metric.name].of(OverTosses).tracking_floor
        if floor is not None:
            parts.append(f"{figure(floor, metric.unit)} {metric.unit}")
    return (
        f"The measurement itself leaves {' and '.join(parts)}: the mean error of a cube in free fall before its first "
        "contact, which begins with the measured first state. An error that is not much larger says nothing of a "
        "simulator."
    )


def _per_toss(result: GroupResult) -> tuple[float, ...]:
    found = result.metrics[TOSS_POSITION.name]
    return () if isinstance(found.value, Missing) else found.of(OverTosses).per_toss
