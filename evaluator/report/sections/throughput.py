"""Throughput, what was timed, memory and times of preparation at one number of environments."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from gpusimbench.evaluator.missing import known
from gpusimbench.evaluator.render.document import Block, Cell, Column, Items, Section, Text, items
from gpusimbench.evaluator.render.numbers import NONE, plural
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.leaders import fastest
from gpusimbench.evaluator.report.sections.rows import Reasons
from gpusimbench.evaluator.report.sections.values import Written, column_of, of_groups
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.cost_metrics import CAPTURE_OVERHEAD, FPS
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.results.metric import Metric, Table
from gpusimbench.evaluator.results.result import GroupResult

_HOW = (
    "Mean ± SD over runs, with the 95 % interval; times of building and compiling are medians. Throughput is "
    "environments x steps divided by the time of the timed phase, in which nothing is recorded. Compare throughputs on "
    "one device only, and over the same steps of the scene."
)

_OTHER_STEPS = "captured and timed steps are other steps of the scene: a difference in contacts counts as well"


def section(source: Source) -> Section | None:
    """None where no group is left."""
    if not source.shown:
        return None
    costs = [metric for metric in source.columns(Table.THROUGHPUT) if metric is not FPS]
    scenes = dict.fromkeys(r.group.key.scene for r in source.shown)
    blocks: list[Block] = [Text(_HOW)]
    if hidden := len(source.hidden):
        blocks.append(Text(f"{plural(hidden, 'group')} of sweeps that captured no states: see scaling."))
    for scene in scenes:
        results = [r for r in source.shown if r.group.key.scene == scene]
        if any(r.group.complete for r in results):
            blocks += _of_scene(scene, results, costs)
        else:
            blocks.append(Text(f"{scene}: no run of {', '.join(r.label for r in results)} is complete."))
    return Section("throughput", "Throughput and memory", tuple(blocks), _summary(source.shown), folded=True)


def _of_scene(scene: str, results: list[GroupResult], costs: list[Metric]) -> Iterator[Block]:
    speeds, memory = Reasons(), Reasons()
    beside = timed.columns(r.timed for r in results)
    speed_columns = [
        column_of(FPS, speeds, _shared),
        (Column("runs"), lambda r: Cell(str(r.metrics[FPS.name].n), float(r.metrics[FPS.name].n))),
        *((Column(one.title), _timed(one)) for one in beside),
        (Column("what lies between the clocks"), _covers),
    ]
    yield of_groups(f"throughput-{scene}", f"Throughput, {scene}", results, speed_columns, speeds)
    yield from _remarks(results)
    costly = [column_of(metric, memory, _fewer(metric)) for metric in costs]
    slowed = any(known(r.metrics[CAPTURE_OVERHEAD.name].value) is not None for r in results)
    legend = [_OTHER_STEPS] if slowed else []
    yield of_groups(f"costs-{scene}", f"Memory and times of preparation, {scene}", results, costly, memory, legend)


def _timed(column: timed.Column) -> Written:
    return lambda result: Cell(column.cell(result.timed))


def _shared(result: GroupResult) -> Iterable[str]:
    told = words.shared(result.metrics[FPS.name])
    return [f"another process on the GPU: {told}"] if told else []


def _fewer(metric: Metric) -> Callable[[GroupResult], Iterable[str]]:
    """Of how many runs a value is, where these are not all complete ones."""

    def said(result: GroupResult) -> list[str]:
        n, runs = result.metrics[metric.name].n, len(result.group.complete)
        return [f"of {plural(n, 'run')}"] if 0 < n < runs else []

    return said


def _covers(result: GroupResult) -> Cell:
    return Cell(result.metrics[FPS.name].of(Throughput).timing_covers or NONE)


def _remarks(results: list[GroupResult]) -> Iterator[Items]:
    if lines := timed.remarks(results):
        yield items(*lines)


def _summary(results: list[GroupResult]) -> str:
    """The fastest valid simulator of each scene; see `leaders`."""
    found = [one.first for one in fastest(results) if one.first]
    if not found:
        return "mean ± SD of each group"
    return "fastest in " + "; ".join(
        f"{one.scene}: {one.result.group.key.simulator}, {one.fps:,.0f} {FPS.unit} on {one.result.group.key.device}"
        for one in found
    )
