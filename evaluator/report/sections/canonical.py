"""Motions that are known in closed form: measured, predicted, and the smallest change that would show."""

from __future__ import annotations

from collections.abc import Sequence

from gpusimbench.evaluator.render.document import Cell, Column, Row, Section, Table, Text, Tone
from gpusimbench.evaluator.render.numbers import NONE, plural
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.canonical import Law, Sensitivity, Unmeasured

_TITLES = ("simulator", "law", "envs", "measured", "predicted", "difference", "tolerance", "smallest change", "verdict")
_UNITS = {"damping": "N m s/rad", "angular damping": "1/s"}  # of parameters whose change is no share
_HOW = (
    "Difference: measured minus predicted, mean over environments, with its 95 % interval. Held: the interval comes "
    "within the tolerance of zero. Smallest change: of a parameter of the engine, which two recordings of these "
    "environments, before and after the change, tell apart in 95 of 100 cases (two-sided test, 5 %)."
)


def section(source: Source) -> Section | None:
    """None without canonical scenes."""
    found = [law for result in source.shown for law in result.laws]
    if not found:
        return None
    measured = [law for law in found if isinstance(law, Law)]
    broken = sum(not law.held for law in measured)
    missing = [law for law in found if isinstance(law, Unmeasured)]
    said = ", ".join(
        [f"{broken} of {plural(len(measured), 'law')} broken"] * bool(measured)
        + [f"{len(missing)} not measured"] * bool(missing)
    )
    shown = Table("canonical", "", tuple(map(Column, _TITLES)), tuple(Row(_cells(law)) for law in measured))
    reasons = (Text(f"{law.label}: {law.title} not measured: {law.reason}.", Tone.QUIET) for law in missing)
    return Section("canonical", "Laws in closed form", (Text(_HOW), shown, *reasons), said, folded=True)


def _cells(law: Law) -> tuple[Cell, ...]:
    unit = f" [{law.unit}]" if law.unit else ""
    off = f"{law.difference:.3g}"
    if law.ci95:
        off += f" [{law.ci95[0]:.3g}, {law.ci95[1]:.3g}]"
    changes = "; ".join(map(change, law.sensitivities))
    verdict = Cell("held", tone=Tone.GOOD) if law.held else Cell("BROKEN", tone=Tone.BAD)
    envs = Cell(f"{law.count} of {law.of_envs}", law.count, notes=(law.absent,) if law.absent else ())
    return (
        Cell(law.label), Cell(law.title + unit), envs,
        Cell(f"{law.measured:.5g}", law.measured), Cell(f"{law.predicted:.5g}", law.predicted),
        Cell(off, law.difference), Cell(f"{law.tolerance:.3g}", law.tolerance, notes=(law.of,)),
        Cell(changes or NONE), verdict,
    )  # fmt: skip


def change(one: Sensitivity) -> str:
    """A sensitivity in words."""
    if one.least is None:
        return f"insensitive to {one.parameter}"
    unit = _UNITS.get(one.parameter)
    size = f"{one.least:.2g} {unit}" if unit else f"{100 * one.least:.2g} %"
    return f"{one.parameter} {size}"


def sentence(laws: Sequence[Law | Unmeasured]) -> str:
    """The laws of one group in a sentence, which names those that are broken and those that were not measured."""
    measured = [law for law in laws if isinstance(law, Law)]
    broken = [law for law in measured if not law.held]
    said = f"{laws[0].label}: {len(measured) - len(broken)} of {plural(len(measured), 'law')} in closed form held"
    units = [f" {law.unit}" if law.unit else "" for law in broken]
    off = [f"{x.title} {x.measured:.4g}{u}, predicted {x.predicted:.4g}{u}" for x, u in zip(broken, units, strict=True)]
    missing = [f"{law.title}: {law.reason}" for law in laws if isinstance(law, Unmeasured)]
    return (
        said
        + (f"; BROKEN: {'; '.join(off)}" if off else "")
        + (f"; not measured: {'; '.join(missing)}" if missing else "")
    )
