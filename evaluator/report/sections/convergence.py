"""How fast states approach those of the finest step: the order of convergence of each engine."""

from __future__ import annotations

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Cell, Column, Row, Section, Table, Text, Tone
from gpusimbench.evaluator.render.numbers import NONE, plural
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.convergence import Convergence
from gpusimbench.evaluator.statistics.convergence import AGREE

_HOW = (
    "Errors are distances between the states at the same time and those of the finest step, root mean square over "
    "environments. The order p is fitted to C (dt^p - finest^p) by least squares of the logarithm; 95 % interval by "
    "resampling environments. Not in the asymptotic range: a local order, of two neighbouring steps, is more than "
    f"{AGREE:g} from the fitted order, so that the fitted order is not that of the method."
)


def section(source: Source) -> Section | None:
    """None without groups that differ in the step alone."""
    found = source.evaluation.convergences
    if not found:
        return None
    columns = tuple(
        map(
            Column,
            ("simulator", "scene", "compared", "finest step [s]", "error at the largest step", "order", "local orders"),
        )
    )
    rows = tuple(Row(_cells(one)) for one in found)
    remarks = tuple(f"{one.label}: left out {why}" for one in found for why in one.left_out)
    every = Table("convergence", "", columns, rows, remarks)
    said = plural(len(found), "simulator")
    return Section("convergence", "Convergence with the time step", (Text(_HOW), every), said, folded=True)


def _cells(one: Convergence) -> tuple[Cell, ...]:
    compared = f"{one.what} [{one.unit}] at {one.time:g} s"
    head = (Cell(one.label), Cell(one.scene), Cell(compared), Cell(f"{one.finest:g}", one.finest))
    if isinstance(one.found, Missing):
        return (*head, Cell(NONE), Cell(NONE, notes=(one.found.reason,), tone=Tone.QUIET), Cell(NONE))
    order = one.found
    error = f"{order.errors[0]:.3g} at {order.steps[0]:g} s"
    notes = () if order.asymptotic else ("not in the asymptotic range",)
    tone = Tone.PLAIN if order.asymptotic else Tone.WARNING
    local = ", ".join(f"{p:.2f}" for p in order.local)
    return (*head, Cell(error, order.errors[0]), Cell(said(one), order.order, notes=notes, tone=tone), Cell(local))


def sentence(one: Convergence) -> str:
    """The order in a sentence."""
    name = f"{one.label}, {one.scene}: order of convergence in dt"
    if isinstance(one.found, Missing):
        return f"{name} not known: {one.found.reason}"
    return f"{name} {said(one)}{'' if one.found.asymptotic else ', not in the asymptotic range'}"


def said(one: Convergence) -> str:
    """The order with its interval, or a dash."""
    if isinstance(one.found, Missing):
        return NONE
    if isinstance(one.found.ci95, Missing):
        return f"{one.found.order:.2f}"
    low, high = one.found.ci95
    return f"{one.found.order:.2f} [{low:.2f}, {high:.2f}]"
