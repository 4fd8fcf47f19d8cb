"""Errors against tosses: a row for each group, the most accurate first, each compared with the first."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.render.document import EMPTY, Block, Cell, Column, Section, Text
from gpusimbench.evaluator.render.document import Table as Grid
from gpusimbench.evaluator.render.numbers import bounds, distance, figure
from gpusimbench.evaluator.report.leaders import fastest, speaks_against_pair
from gpusimbench.evaluator.report.sections.rows import Reasons, Written, column_of, of_groups
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.cost_metrics import FPS
from gpusimbench.evaluator.results.details import OverTosses
from gpusimbench.evaluator.results.metric import Metric, Table
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.results.toss_metrics import (
    TOSS_LOCAL_METRICS,
    TOSS_LOCAL_POSITION,
    TOSS_POSITION,
    TOSS_ROTATION,
    Ranked,
    beaten_by,
    ranked,
)
from gpusimbench.schemas.text import plural

_LEGEND = (
    "Each simulated toss is compared with the toss of the set from whose first state it began, at the rows of the set.",
    "95 % intervals: tosses resampled.",
    "more than the first: mean over tosses of the error less that of the first group, toss by toss; p: sign-flip "
    "permutation test, adjusted by Holm's method for all rows; visible: the smallest difference that these tosses show "
    "with 95 % probability",
)


_LOCAL_LEGEND = (
    "The cube is set to each k-th row of the set's toss, and is compared with the row k rows later, just before it is "
    "set again. An early error is no part of later ones.",
    "95 % intervals: tosses resampled.",
)


def section(source: Source) -> Section | None:
    """None where nothing was compared with tosses."""
    order, local = ranked(source.shown, source.evaluation.results), _local(source)
    blocks, said = _whole_tosses(source, order) if order else ([], "")
    if local:
        blocks.append(local)
        said = "; ".join(filter(None, (said, f"{plural(len(local.rows), 'group')} with local errors")))
    return Section("tosses", f"Accuracy: {_kind(source)}", tuple(blocks), said, folded=True) if blocks else None


def _kind(source: Source) -> str:
    reference = source.evaluation.reference
    return reference.tosses.known.kind if reference and reference.tosses else "tosses"


def _local(source: Source) -> Grid | None:
    """Groups that are set to measured states on the way: the fewest rows between settings first, then the smallest
    error."""
    found = [r for r in source.shown if known(r.metrics[TOSS_LOCAL_POSITION.name].value) is not None]
    if not found:
        return None
    found.sort(key=lambda r: (_details(r).rows or 0, known(r.metrics[TOSS_LOCAL_POSITION.name].value) or 0.0))
    reasons = Reasons()
    columns = [column_of(metric, reasons) for metric in TOSS_LOCAL_METRICS]
    columns.insert(0, (Column("rows", "rows of the toss from each setting on"), lambda r: _number(_details(r).rows)))
    columns.append((Column("tosses", "that have more rows"), lambda r: _number(_details(r).tosses)))
    for metric in TOSS_LOCAL_METRICS:
        columns.append(_measured_floor(metric))
    title = f"Local errors against {_kind(source)}"
    return of_groups(source, "local", title, found, columns, reasons, _LOCAL_LEGEND)


def _details(result: GroupResult) -> OverTosses:
    return result.metrics[TOSS_LOCAL_POSITION.name].of(OverTosses)


def _number(value: int | None) -> Cell:
    return EMPTY if value is None else Cell(f"{value}", float(value))


def _measured_floor(metric: Metric) -> tuple[Column, Written]:
    def cell(result: GroupResult) -> Cell:
        floor = result.metrics[metric.name].of(OverTosses).tracking_floor
        return EMPTY if floor is None else Cell(figure(floor, metric.unit), floor)

    title = f"free flight, {metric.title.removeprefix('local error of ')} [{metric.unit}]"
    return Column(title, "the same error of a cube in free flight, which no simulation can go below"), cell


def _whole_tosses(source: Source, order: Sequence[Ranked]) -> tuple[list[Block], str]:
    """Whole tosses: the table of errors, what stands below it, and both in a sentence."""
    best = order[0].result
    reasons = Reasons()
    metrics = source.columns(Table.REALITY)
    columns = [column_of(metric, reasons) for metric in metrics]
    columns.insert(1, _more_than_first(order))
    against = {one.result.label: speaks_against_pair(one, source.evaluation.results) for one in order}
    front = beaten_by([one for one in order if not against[one.result.label]])
    if front:
        columns += [_throughput(order, reasons), _on_the_front(order, front, against)]
    title = f"Errors against {_kind(source)}"
    blocks: list[Block] = [
        of_groups(source, "tosses", title, [one.result for one in order], columns, reasons, _LEGEND),
        Text(_floor(best)),
    ]
    error = known(best.metrics[TOSS_POSITION.name].value) or 0.0
    reference = source.evaluation.reference
    # not every set of tosses was measured: what the set says of itself stands before any error
    what = f"{reference.label}; " if reference and reference.tosses else ""
    said = f"{what}{plural(len(order), 'group')}; smallest error of position: {best.label}, {figure(error, 'cm')} cm"
    if quick := _fastest_at_equal_accuracy(source, {one.result.group.key.scene for one in order}):
        blocks.append(Text(quick))
        said += f"; {quick[0].lower()}{quick[1:].rstrip('.')}"
    return blocks, said


def _more_than_first(order: Sequence[Ranked]) -> tuple[Column, Written]:
    found = {one.result.label: one for one in order}

    def cell(result: GroupResult) -> Cell:
        one = found[result.label]
        if one.against is None or one.adjusted is None:
            return EMPTY
        span = bounds(one.against.ci95, distance) if one.against.ci95 else ""
        p = "p < 0.001" if one.adjusted < 0.001 else f"p = {one.adjusted:.2g}"
        least = one.against.visible
        visible = "one toss alone" if least is None else f"visible from {figure(least, 'cm')}"
        return Cell(figure(one.against.mean, "cm"), one.against.mean, one.against.ci95, span, (p, visible))

    return Column("more than the first [cm]", "error of position less that of the first row, toss by toss"), cell


def _throughput(order: Sequence[Ranked], reasons: Reasons) -> tuple[Column, Written]:
    column, written = column_of(FPS, reasons)
    timed = {one.result.label: one.timed for one in order}

    def cell(result: GroupResult) -> Cell:
        of = timed[result.label]
        if of is None:
            return written(result)
        found, n_env = written(of), of.group.key.n_env
        return found if n_env == result.group.key.n_env else replace(found, notes=(*found.notes, plural(n_env, "env")))

    return column, cell


def _on_the_front(
    order: Sequence[Ranked], front: Mapping[str, str], against: Mapping[str, str]
) -> tuple[Column, Written]:
    found = {one.result.label: one for one in order}

    def cell(result: GroupResult) -> Cell:
        if result.label not in front:
            return Cell("not ranked", notes=(against[result.label],)) if against[result.label] else EMPTY
        better = f"{front[result.label]} is faster and not measurably less accurate" if front[result.label] else ""
        accuracy = found[result.label].less_accurate or "as accurate as the best"
        return Cell("no" if better else "yes", notes=tuple(filter(None, (better, accuracy))))

    return Column(
        "on the front",
        "whether no other group simulates more time in a time, with errors that the tosses do not show to be larger",
    ), cell


def _fastest_at_equal_accuracy(source: Source, scenes: Collection[str]) -> str:
    said = []
    for one in fastest(source.evaluation.results):
        if one.first and one.scene in scenes:
            device = one.device or "an unnamed device"
            said.append(f"{one.first.result.label}, {one.first.said} on {device}")
    return f"Fastest at equal accuracy: {'; '.join(said)}." if said else ""


def _floor(result: GroupResult) -> str:
    """What the rows of the set leave."""
    parts = []
    for metric in (TOSS_POSITION, TOSS_ROTATION):
        floor = result.metrics[metric.name].of(OverTosses).tracking_floor
        if floor is not None:
            parts.append(f"{figure(floor, metric.unit)} {metric.unit}")
    return (
        f"The rows of the set leave {' and '.join(parts)}: the mean error of a cube in free fall before its first "
        "contact, which begins with the first state of the toss. An error that is not much larger says nothing of a "
        "simulator."
    )
