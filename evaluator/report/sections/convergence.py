"""How fast states approach those of the finest step: the order of convergence of each engine."""

from __future__ import annotations

from gpusimbench.evaluator.missing import Missing
from gpusimbench.evaluator.render.document import Cell, Column, Row, Section, Table, Text, Tone
from gpusimbench.evaluator.render.numbers import NONE, bounds
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.convergence import AGREE, Convergence, Order
from gpusimbench.schemas.text import plural

NOT_ASYMPTOTIC = "not in the asymptotic range"

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
    if isinstance(order.order, Missing):
        fitted = Cell(NONE, notes=(order.order.reason,), tone=Tone.QUIET)
    elif order.asymptotic:
        fitted = Cell(said(one), order.order)
    else:
        fitted = Cell(said(one), order.order, notes=(NOT_ASYMPTOTIC,), tone=Tone.WARNING)
    return (*head, Cell(error, order.errors[0]), fitted, Cell(said_locally(order)))


def sentence(one: Convergence) -> str:
    """The order in a sentence."""
    name = f"{one.label}, {one.scene}: order of convergence in dt"
    if reason := why_none(one):
        return f"{name} not known: {reason}"
    return f"{name} {said(one)}{'' if _asymptotic(one) else f', {NOT_ASYMPTOTIC}'}"


def why_none(one: Convergence) -> str:
    """Why there is no order; empty where there is."""
    order = one.found if isinstance(one.found, Missing) else one.found.order
    return order.reason if isinstance(order, Missing) else ""


def _asymptotic(one: Convergence) -> bool:
    return not isinstance(one.found, Missing) and one.found.asymptotic


def said_locally(order: Order) -> str:
    """The local orders, with a dash where there is none."""
    return ", ".join(NONE if isinstance(p, Missing) else f"{p:.2f}" for p in order.local)


def said(one: Convergence) -> str:
    """The order with its interval, or a dash."""
    if isinstance(one.found, Missing) or isinstance(one.found.order, Missing):
        return NONE
    if isinstance(one.found.ci95, Missing):
        return f"{one.found.order:.2f}"
    return f"{one.found.order:.2f} {bounds(one.found.ci95, '{:.2f}'.format)}"
