"""Motions that are known in closed form: measured, predicted, and the smallest change that would show."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.evaluator.render.document import Cell, Column, Row, Section, Table, Text, Tone
from gpusimbench.evaluator.render.numbers import NONE, plural
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.canonical import LARGEST, UNITS, Law, Sensitivity

_TITLES = ("simulator", "law", "envs", "measured", "predicted", "difference", "tolerance", "smallest change", "verdict")
_HOW = (
    "Difference: measured minus predicted, mean over environments, with its 95 % interval. Held: the interval comes "
    "within the tolerance of zero. Smallest change: of a parameter of the engine, which two recordings of these "
    "environments, before and after the change, tell apart in 95 of 100 cases (rank-sum test, 5 %); in brackets, the "
    "change with which the law is BROKEN in 95 of 100 recordings."
)


def section(source: Source) -> Section | None:
    """None without canonical scenes."""
    found = [law for result in source.shown for law in result.laws]
    if not found:
        return None
    broken = sum(not law.held for law in found)
    said = f"{broken} of {plural(len(found), 'law')} broken"
    shown = Table("canonical", "", tuple(map(Column, _TITLES)), tuple(Row(_cells(law)) for law in found))
    return Section("canonical", "Laws in closed form", (Text(_HOW), shown), said, folded=True)


def _cells(law: Law) -> tuple[Cell, ...]:
    unit = f" [{law.unit}]" if law.unit else ""
    off = f"{law.difference:.3g}"
    if law.ci95:
        off += f" [{law.ci95[0]:.3g}, {law.ci95[1]:.3g}]"
    changes = "; ".join(map(change, law.sensitivities))
    verdict = Cell("held", tone=Tone.GOOD) if law.held else Cell("BROKEN", tone=Tone.BAD)
    return (
        Cell(law.label), Cell(law.title + unit), Cell(f"{law.count} of {law.of_envs}", law.count),
        Cell(f"{law.measured:.5g}", law.measured), Cell(f"{law.predicted:.5g}", law.predicted),
        Cell(off, law.difference), Cell(f"{law.tolerance:.3g}", law.tolerance, notes=(law.of,)),
        Cell(changes or NONE), verdict,
    )  # fmt: skip


def change(one: Sensitivity) -> str:
    """A sensitivity in words."""
    if not one.slope:
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


def sentence(laws: Sequence[Law]) -> str:
    """The laws of one group in a sentence, which names those that are broken."""
    broken = [law for law in laws if not law.held]
    said = f"{laws[0].label}: {len(laws) - len(broken)} of {plural(len(laws), 'law')} in closed form held"
    return said + (f"; BROKEN: {'; '.join(law.said for law in broken)}" if broken else "")
