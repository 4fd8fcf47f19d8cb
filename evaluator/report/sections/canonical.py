"""Motions that are known in closed form: measured, predicted, and the smallest change that would show."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.evaluator.render.document import Cell, Column, Row, Section, Table, Text, Tone
from gpusimbench.evaluator.render.numbers import NONE, bounds
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.canonical import LARGEST, UNITS, Law, Sensitivity, Unmeasured
from gpusimbench.schemas.text import plural

_TITLES = ("simulator", "law", "envs", "measured", "predicted", "difference", "tolerance", "smallest change", "verdict")
_HOW = (
    "Difference: measured minus predicted, mean over environments, with its 95 % interval. Held: the interval comes "
    "within the tolerance of zero. No verdict: nothing that the engine was given predicts the value, whose own "
    "interval and standard deviation (sd) over environments are shown. Smallest change: of a parameter of the engine, "
    "which two recordings of these environments, before and after the change, tell apart in 95 of 100 cases (rank-sum "
    "test, 5 %); in brackets, the change with which the law is BROKEN in 95 of 100 recordings. A law of counts has the "
    "chi-squared statistic of Pearson's test as its value, the degrees of freedom as its prediction, and the number of "
    "throws instead of environments."
)


def section(source: Source) -> Section | None:
    """None without canonical scenes."""
    found = [law for result in source.shown for law in result.laws]
    if not found:
        return None
    measured = [law for law in found if isinstance(law, Law)]
    judged = [law for law in measured if law.held is not None]
    broken = sum(not law.held for law in judged)
    missing = [law for law in found if isinstance(law, Unmeasured)]
    said = ", ".join(
        [f"{broken} of {plural(len(judged), 'law')} broken"] * bool(judged)
        + [f"{len(measured) - len(judged)} without a verdict"] * (len(measured) > len(judged))
        + [f"{len(missing)} not measured"] * bool(missing)
    )
    shown = Table("canonical", "", tuple(map(Column, _TITLES)), tuple(Row(_cells(law)) for law in measured))
    reasons = (Text(f"{law.label}: {law.title} not measured: {law.reason}.", Tone.QUIET) for law in missing)
    return Section("canonical", "Laws in closed form", (Text(_HOW), shown, *reasons), said, folded=True)


def _cells(law: Law) -> tuple[Cell, ...]:
    unit = f" [{law.unit}]" if law.unit else ""
    interval = bounds(law.ci95, "{:.3g}".format) if law.ci95 else ""
    changes = "; ".join(map(change, law.sensitivities))
    verdict = Cell("held", tone=Tone.GOOD) if law.held else Cell("BROKEN", tone=Tone.BAD)
    difference, predicted = Cell(NONE), Cell(NONE)
    if law.difference is None or law.predicted is None:
        verdict = Cell("no verdict", notes=(law.held_missing,), tone=Tone.QUIET)
        value = Cell(f"{law.measured:.5g} {interval}".rstrip(), law.measured, notes=(f"sd {law.sd:.2g}",))
    else:
        difference = Cell(f"{law.difference:.3g} {interval}".rstrip(), law.difference)
        value, predicted = Cell(f"{law.measured:.5g}", law.measured), Cell(f"{law.predicted:.5g}", law.predicted)
    envs = Cell(f"{law.count} of {law.of_envs}", law.count, notes=law.left_out)
    return (
        Cell(law.label), Cell(law.title + unit), envs,
        value, predicted, difference, Cell(f"{law.tolerance:.3g}", law.tolerance, notes=(law.tolerance_formula,)),
        Cell(changes or NONE), verdict,
    )  # fmt: skip


def change(one: Sensitivity) -> str:
    """A sensitivity in words."""
    if one.slope == 0:
        return f"insensitive to {one.parameter}"
    if one.least is None:
        return (
            f"no {one.parameter}{f' up to {100 * LARGEST:g} %' if one.parameter not in UNITS else ''} is sure to show"
        )
    broken = f" ({size(one.breaks, one.parameter)})" if one.breaks else ""
    return f"{one.parameter} {size(one.least, one.parameter)}{broken}"


def size(change: float, parameter: str) -> str:
    """A change of a parameter with its unit."""
    return f"{change:.2g} {UNITS[parameter]}" if parameter in UNITS else f"{100 * change:.2g} %"


def sentence(laws: Sequence[Law | Unmeasured]) -> str:
    """The laws of one group in a sentence, which names those that are broken and those that were not measured."""
    measured = [law for law in laws if isinstance(law, Law)]
    judged = [law for law in measured if law.held is not None]
    broken = [law.said for law in judged if not law.held]
    said = [f"{laws[0].label}: {len(judged) - len(broken)} of {plural(len(judged), 'law')} in closed form held"]
    said += [f"BROKEN: {'; '.join(broken)}"] * bool(broken)
    unjudged = [law.said for law in measured if law.held is None]
    said += [f"without a verdict: {'; '.join(unjudged)}"] * bool(unjudged)
    missing = [f"{x.title}: {x.reason}" for x in laws if isinstance(x, Unmeasured)]
    said += [f"not measured: {'; '.join(missing)}"] * bool(missing)
    return "; ".join(said)
