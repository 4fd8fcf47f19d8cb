"""Variability between environments and between runs: classes of equal bits, distances, and the published type."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from gpusimbench.evaluator.missing import Missing, known
from gpusimbench.evaluator.render.document import Block, Cell, Column, Section, Text, Tone, items, key_of
from gpusimbench.evaluator.render.numbers import NONE, distance_bound, mean_sd
from gpusimbench.evaluator.report import words
from gpusimbench.evaluator.report.sections.rows import Reasons, Written, column_of, of_groups, value
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.details import (
    BetweenEnvs,
    BetweenRuns,
    DistinctEnvs,
    DistinctRuns,
    Equality,
    ToReference,
)
from gpusimbench.evaluator.results.group_metrics import (
    LEFT_BOARD,
    REGIME,
    SANK,
    SUFFIX,
    W1_PARALLEL,
    W1_REAL,
    W1_RUN_TO_RUN,
)
from gpusimbench.evaluator.results.identity_metrics import (
    DISTINCT_ENVS,
    DISTINCT_RUNS,
    EQUALITY_ENVS,
    EQUALITY_RUNS,
    identical,
)
from gpusimbench.evaluator.results.joint_metrics import JOINT_METRICS
from gpusimbench.evaluator.results.metric import Estimate, Metric
from gpusimbench.evaluator.results.metric import Table as TableOf
from gpusimbench.evaluator.results.result import GroupResult
from gpusimbench.evaluator.statistics.regimes import REGIME_MEANING
from gpusimbench.schemas.text import plural

_BITS = "Environments and runs with other bits, and how far apart they are"
_OTHERS = "Bodies that were lost, growth of differences, and what capturing changed"
_DISTANCES = "Further W1 between planar positions"
_JOINTS = "Distances in joint space: angles in rad, sliding joints in cm"
_JOINTS_LEGEND = {
    "": "root mean square over the joints of the difference of two environments, or of the same environment of two "
    "runs; hinges and ball joints are in one number, sliding joints in another",
}
_WHERE = (
    "W1 compares where bodies lie seen from above, whichever body lies where: bodies that swapped places, or that "
    "differ in height or angle only, are at distance 0. Only the counts of distinct environments and runs compare all "
    "bits."
)
_ZERO = "0 alone is an exact zero; published tables round, and their 0.00 can hide up to 0.005 cm"
_CLAMPED = "clamped"
_DISTANCES_LEGEND = {
    "": f"{_WHERE} {_ZERO}",
    _CLAMPED: "clamped: each body beside the board is put at its nearest edge, so that flight after a fall does not "
    "count",
    words.EXCHANGED: f"{words.EXCHANGED}: W1 of the first two runs (or of the first run and the reference), its mean "
    "with whole environments exchanged between them at random, and the share of exchanges that give as much",
}
"""Beginnings of titles, and what must be known to read such columns."""


def section(source: Source) -> Section | None:
    """None where no group is left."""
    results = source.shown
    if not results:
        return None
    placed = source.evaluation.of_bodies
    bits, apart, joints, others = Reasons(), Reasons(), Reasons(), Reasons()
    distances = [W1_PARALLEL, W1_RUN_TO_RUN, *([W1_REAL] if source.evaluation.reference else [])]
    told = {DISTINCT_ENVS, DISTINCT_RUNS, EQUALITY_ENVS, EQUALITY_RUNS, REGIME, W1_PARALLEL, W1_RUN_TO_RUN, W1_REAL}
    told |= set(JOINT_METRICS)
    rest = [m for m in source.columns(TableOf.VARIABILITY) if m not in told and not m.name.endswith(SUFFIX)]
    rest = rest if placed else [m for m in rest if m not in (LEFT_BOARD, SANK)]
    of_bits = [
        _distinct(DISTINCT_ENVS, EQUALITY_ENVS, bits),
        _distinct(DISTINCT_RUNS, EQUALITY_RUNS, bits),
        *([(Column(REGIME.titled, REGIME.method), _type(bits))] if placed else []),
    ]
    of_others = [column_of(m, others) if m not in (LEFT_BOARD, SANK) else _cubes(m, others) for m in rest]
    of_bits += [(Column(m.titled, m.method), _distance(m, bits)) for m in distances if placed]
    legend = [*types_of(results), _WHERE, _ZERO] if placed else []
    more = (
        ("distances", _DISTANCES, [*_apart(distances)], apart, _DISTANCES_LEGEND),
        ("joints", _JOINTS, [column_of(metric, joints) for metric in JOINT_METRICS], joints, _JOINTS_LEGEND),
        ("others", _OTHERS, of_others, others, dict[str, str]()),
    )
    blocks: list[Block] = [
        of_groups(source, "variability", _BITS, results, of_bits, bits, legend),
        *(part for one in more for part in _closed(source, *one)),
    ]
    if not source.evaluation.reference and not source.evaluation.of_programs:
        blocks.append(Text(f"No distance to real trials: {source.evaluation.reference_note}."))
    claims = [identical(r.metrics[DISTINCT_RUNS.name]).holds for r in results]
    said = words.repeating(claims) if set(claims) - {None} else "no group has several runs whose bits can be compared"
    return Section("variability", "Variability", tuple(blocks), said, folded=True)


def _closed(
    source: Source, name: str, caption: str, columns: Sequence[tuple[Column, Written]], reasons: Reasons,
    legend: Mapping[str, str],
) -> Iterator[Block]:  # fmt: skip
    """A closed table of the groups that have anything in it; where none has, the reasons in a line each, if any.

    legend  of columns by the beginnings of their titles: a line stands only below a table that has such a column
    """
    key = f"variability-{name}"
    found = of_groups(source, key, "", source.shown, columns, reasons, with_any=True)
    if found.rows:
        titles = [column.title for column in found.columns]
        lines = tuple(line for start, line in legend.items() if any(title.startswith(start) for title in titles))
        found = replace(found, legend=(*lines, *found.legend))
        said = plural(len(found.rows), "group")
        yield Section(key_of("more", key), caption, (found,), said, folded=True)
    elif name != "joints" and found.legend:
        yield items(*found.legend)


def _distinct(counted: Metric, level: Metric, reasons: Reasons) -> tuple[Column, Written]:
    def cell(result: GroupResult) -> Cell:
        found, equal = result.metrics[counted.name], result.metrics[level.name]
        details = found.details
        first = details.first_difference_step if isinstance(details, DistinctEnvs | DistinctRuns) else None
        alike = "" if isinstance(found.value, Missing) else words.all_alike(found)
        said = [f"first differ at step {first}" if first is not None else alike]
        if first is not None or isinstance(found.value, Missing):
            note = equal.of(Equality).note
            said.append(": ".join(filter(None, (words.equality(equal), note))))
        holds = identical(found).holds
        tone = Tone.PLAIN if holds is None else Tone.GOOD if holds else Tone.BAD
        made = value(found, reasons, *said, tone=tone)
        extra = tuple(one for one in said if one and one != NONE)
        return (
            made
            if not isinstance(found.value, Missing)
            else Cell(made.text, notes=(*made.notes, *extra), tone=made.tone)
        )

    return Column(counted.titled, counted.method), cell


def _type(reasons: Reasons) -> Written:
    def cell(result: GroupResult) -> Cell:
        found = result.metrics[REGIME.name]
        if isinstance(found.value, Missing):
            return reasons.cell(found.value.reason)
        again = words.resampled(found)
        more = [words.another(again)] if again and again.run_differs_below else []
        number, _, why = words.regime(found).partition(" ")
        return Cell(number, found.value, notes=tuple(filter(None, (why.strip("()"), *more))))

    return cell


def types_of(results: Sequence[GroupResult]) -> Iterator[str]:
    """What the published types of some groups mean."""
    found = {int(value) for r in results if (value := known(r.metrics[REGIME.name].value)) is not None}
    yield from (f"type {number}: {REGIME_MEANING[number]}" for number in sorted(found & REGIME_MEANING.keys()))


def _apart(distances: list[Metric]) -> Iterator[tuple[Column, Written]]:
    for metric in distances:
        yield Column(f"{_CLAMPED} {metric.title} [{metric.unit}]"), _clamped(metric)
        if metric is not W1_PARALLEL:
            yield Column(words.EXCHANGED), _floor(metric)


def _distance(metric: Metric, reasons: Reasons) -> Written:
    def cell(result: GroupResult) -> Cell:
        found = result.metrics[metric.name]
        drawn = found.of(BetweenEnvs).sampled
        note = f"sampled: {drawn.envs} envs of a run drawn with seed {drawn.seed}" if drawn else ""
        return value(found, reasons, note, _bounds(found))

    return cell


def _bounds(found: Estimate) -> str:
    """Between which bounds a value lies that is not exact."""
    details = found.details
    bounds = details.bounds_cm if isinstance(details, BetweenRuns | ToReference) else None
    if not bounds:
        return ""
    pairs = f", of {found.n} pairs drawn with seed 0" if found.exactness == "sampled" else ""
    low, high = distance_bound(bounds[0], upper=False), distance_bound(bounds[1], upper=True)
    return f"{found.exactness}: between {low} and {high}{pairs}"


def _clamped(metric: Metric) -> Written:
    def cell(result: GroupResult) -> Cell:
        found = result.metrics[metric.name + SUFFIX]
        fell = known(result.metrics[LEFT_BOARD.name].value)  # where no cube left the board, W1 says it all
        return Cell(mean_sd(found) if fell else NONE, known(found.value) if fell else None)

    return cell


def _floor(metric: Metric) -> Written:
    def cell(result: GroupResult) -> Cell:
        found = result.metrics[metric.name]
        why = words.not_exchanged(found)
        return Cell(words.exchanged(found), notes=(f"no floor: {why}",) if why else ())

    return cell


def _cubes(metric: Metric, reasons: Reasons) -> tuple[Column, Written]:
    def cell(result: GroupResult) -> Cell:
        found = result.metrics[metric.name]
        if isinstance(found.value, Missing):
            return reasons.cell(found.value.reason)
        details = found.details
        lines = [f"{getattr(details, 'total', 0):,} of {getattr(details, 'of', 0):,}"]
        if envs := getattr(details, "envs_with_any", 0):
            lines.append(f"in {envs:,} of {plural(found.n, 'env', spec=',')}")
        if found.value and (step := getattr(details, "first_step", None)) is not None:
            lines.append(f"first at step {step}")
        bad = metric is SANK and bool(found.value)
        return value(found, reasons, *lines, tone=Tone.BAD if bad else Tone.PLAIN)

    return Column(metric.titled, metric.method), cell
