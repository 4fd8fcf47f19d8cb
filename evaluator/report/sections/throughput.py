"""Throughput, what was timed, memory and times of preparation at one number of environments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import Block, Cell, Column, Item, Section, Text, Tone, items
from gpusimbench.evaluator.render.numbers import NONE
from gpusimbench.evaluator.report import timed, words
from gpusimbench.evaluator.report.leaders import fastest
from gpusimbench.evaluator.report.sections.rows import (
    Reasons,
    Written,
    column_of,
    lines_of,
    of_groups,
    ordered,
    to_compare,
    without,
)
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.cost_metrics import CAPTURE_OVERHEAD, FPS
from gpusimbench.evaluator.results.details import Throughput
from gpusimbench.evaluator.results.metric import Metric, Table
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.schemas.gathering import gathered
from gpusimbench.schemas.text import plural

_HOW = (
    "Mean ± SD over runs, with the 95 % interval; times of building and compiling are medians. Throughput is "
    "environments x steps divided by the time of the timed phase, in which nothing is recorded. Compare throughputs on "
    "one device only, and over the same steps of the scene."
)

_OTHER_STEPS = "captured and timed steps are other steps of the scene: a difference in contacts counts as well"


def section(source: Source) -> Section | Missing | None:
    """None where no group is left, and of tasks that nobody timed; Missing where nothing was timed or measured."""
    if not source.shown or not (source.evaluation.timed or source.evaluation.of_bodies):
        return None
    ran = [r for r in source.shown if r.group.complete]
    timed_ones = [r for r in ran if known(r.metrics[FPS.name].value) is not None]
    if (
        ran
        and not source.hidden
        and not any(
            known(r.metrics[metric.name].value) is not None for r in ran for metric in source.columns(Table.THROUGHPUT)
        )
    ):
        return without("Throughput and memory", map(_why_not, ran))
    blocks: list[Block] = [Text(_HOW)]
    if hidden := len(source.hidden):
        blocks.append(Text(f"{plural(hidden, 'group')} of sweeps that captured no states: see scaling."))
    blocks += _speeds(source, timed_ones)
    left = [(f"no throughput: {_why_not(r)}", r.label) for r in source.shown if r not in timed_ones]
    if listed := lines_of(left):
        blocks.append(listed)
    if ran:
        blocks += _costs(source, ran)
    said = _summary(source.evaluation.results)
    return Section("throughput", "Throughput and memory", tuple(blocks), said, folded=True)


def _speeds(source: Source, results: list[GroupResult]) -> Iterator[Block]:
    reasons = Reasons()
    beside = [one for one in timed.columns(r.timed for r in results) if one is not timed.SETTINGS_IN_FORCE]
    columns = [column_of(FPS, reasons, _below), *((Column(one.title), _timed(one)) for one in beside)]
    legend = list(_between_clocks(source, results))
    if any(timed.settings(r.timed) != NONE for r in results):
        legend.insert(0, f"solver: {timed.SETTINGS_IN_FORCE.title} in force; a dash for what the engine does not state")
    found = of_groups(source, "throughput", "Throughput", results, columns, reasons, legend)
    if found.rows:
        yield found
    by_scene = ordered(results, "scene")
    lines = [
        f"{scene}: {line}" if len(by_scene) > 1 and line != timed.LEGEND else line
        for scene, of_scene in by_scene.items()
        for line in timed.remarks(of_scene, named=lambda result: source.names[result.label])
    ]
    first = [Item(one, Tone.WARNING) for one in lines if timed.NOT_COMPARABLE in one]
    if first:
        yield items(*first)
    if rest := [one for one in dict.fromkeys(lines) if timed.NOT_COMPARABLE not in one]:
        yield to_compare("throughput", rest)


def _costs(source: Source, results: list[GroupResult]) -> Iterator[Block]:
    reasons = Reasons()
    costs = [metric for metric in source.columns(Table.THROUGHPUT) if metric is not FPS]
    columns = [column_of(metric, reasons, _fewer(metric)) for metric in costs]
    slowed = any(known(r.metrics[CAPTURE_OVERHEAD.name].value) is not None for r in results)
    legend = [_OTHER_STEPS] if slowed else []
    found = of_groups(source, "costs", "", results, columns, reasons, legend, with_any=True)
    if found.rows:
        said = plural(len(found.rows), "group")
        yield Section("costs-of-groups", "Memory and times of preparation", (found,), said, folded=True)
    elif found.legend:
        yield items(*found.legend)


def _why_not(result: GroupResult) -> str:
    found = result.metrics[FPS.name].value
    return found.reason if isinstance(found, Missing) else "no run is complete"


def _timed(column: timed.Column) -> Written:
    return lambda result: Cell(column.cell(result.timed))


def _below(result: GroupResult) -> Iterable[str]:
    """What stands below a throughput: its ranges by outcome, others on the GPU, settings in force."""
    told = words.shared(result.metrics[FPS.name])
    force = timed.settings(result.timed)
    if speeds := result.metrics[FPS.name].of(Throughput).speeds:
        yield f"by outcome: {speeds.ranges}"
    if told:
        yield f"another process on the GPU: {told}"
    yield from _fewer(FPS)(result)
    if force != NONE:
        yield f"solver: {force}"


def _between_clocks(source: Source, results: list[GroupResult]) -> Iterator[str]:
    """What was timed, once for all groups of simulators of which that is true, or for the groups that differ."""
    of_text = gathered((result.metrics[FPS.name].of(Throughput).timing_covers, result) for result in results)
    texts = Counter(name for of in of_text.values() for name in {r.group.key.simulator for r in of})
    for text, of in of_text.items():
        if text:
            who = dict.fromkeys(
                source.names[r.label] if texts[r.group.key.simulator] > 1 else r.group.key.simulator for r in of
            )
            yield f"between the clocks, {', '.join(who)}: {text}"


def _fewer(metric: Metric) -> Callable[[GroupResult], Iterable[str]]:
    """Of how many runs a value is, where these are not all complete ones."""

    def said(result: GroupResult) -> list[str]:
        n, runs = result.metrics[metric.name].n, len(result.group.complete)
        return [f"of {plural(n, 'run')}"] if 0 < n < runs else []

    return said


def _summary(results: Sequence[GroupResult]) -> str:
    """The fastest valid simulator of each scene, points of sweeps included; see `leaders`."""
    found = [one.first for one in fastest(results) if one.first]
    if not found:
        return "mean ± SD of each group"
    return "fastest in " + "; ".join(
        f"{one.scene}: {one.result.group.key.simulator}, {one.said} on {one.result.group.key.device}" for one in found
    )
