"""Changes of a history as people read them."""

from __future__ import annotations

from collections import Counter

from gpusimbench.evaluator.compare.finding import Change, Finding
from gpusimbench.evaluator.compare.history.curves import Curve, Shift
from gpusimbench.evaluator.compare.history.history import Event, History
from gpusimbench.evaluator.render.numbers import bounds, figure
from gpusimbench.schemas.text import plural


def headline(history: History) -> str:
    """The verdict of the whole in one line."""
    if not history.compared:
        return "NOTHING COMPARED: a history needs two points of one configuration on one device"
    newest = history.points[history.newest].label
    if failing := history.failing:
        return f"FAILED at {newest}: {_axes(failing)} ({plural(len(failing), 'change')} on axes with a gate)"
    if history.undecided:
        axes = ", ".join(dict.fromkeys(axis.value for _, axis, _, _ in history.undecided))
        return f"NOT DECIDED at {newest}: {axes} ({len(history.undecided)} of the quantities that have a gate)"
    counting = [event for event in history.events if event.change is not Change.SMALL]
    if not counting:
        return f"NO CHANGE found over {plural(len(history.points), 'point')}"
    kinds = Counter(event.change for event in counting)
    told = [_many(kind, kinds[kind]) for kind in (Change.REGRESSION, Change.CHANGED, Change.IMPROVEMENT) if kinds[kind]]
    at_newest = [event for event in counting if event.point == history.newest]
    last = f"at the newest, {newest}: {_axes(at_newest)}" if at_newest else f"none at the newest, {newest}"
    return f"{', '.join(told)} over {plural(len(history.points), 'point')}; {last}"


def said(event: Event, history: History) -> str:
    """One change in words, without its configuration: what, at which point, by how much."""
    at = history.points[event.point].label
    return f"{at}: {verdict(event)}: {event.title}, {amount(event)}"


def verdict(event: Event) -> str:
    """Its verdict; one below the threshold says so."""
    return "differs, below threshold" if event.change is Change.SMALL else event.change.value


def amount(event: Event) -> str:
    """By how much, or from what to what."""
    if event.curve and event.shift:
        return _shifted(event.shift, event.curve)
    return _stated(event.finding) if event.finding else ""


def visible(curve: Curve) -> str:
    """The smallest change that the next point would show; empty where that cannot be told."""
    if curve.visible is None:
        return ""
    if curve.logs:
        factor = f"{curve.visible:.2g}" if curve.visible < 100 else f"{curve.visible:.0f}"
        return f"{(curve.visible - 1) * 100:.2g} %" if curve.visible < 1.995 else f"a factor of {factor}"
    return f"{figure(curve.visible, curve.metric.unit)} {curve.metric.unit}".strip()


def percent(ratio: float) -> str:
    """A ratio as a signed change: 0.9 is "-10 %"."""
    if not 1e-3 < ratio < 10:
        return f"times {ratio:.3g}"
    return f"{(ratio - 1) * 100:+.3g} %"


def _shifted(shift: Shift, curve: Curve) -> str:
    unit = curve.metric.unit
    levels = f"{figure(shift.before, unit)} -> {figure(shift.after, unit)} {unit}".strip()
    if shift.ratio is None:
        return levels
    span = f" {bounds(shift.ci95, percent)}" if shift.ci95 else ""
    return f"{percent(shift.ratio)}{span} ({levels})"


def _stated(finding: Finding) -> str:
    before, after = finding.said
    if finding.name == "outcome":  # what lies within a point beside what lies between the two
        return f"{after.rpartition(', ')[2]} [cm]"
    if before and after:
        return f"{before} -> {after}"
    return after or before or note(finding)


def note(finding: Finding) -> str:
    """What must be seen beside a fact: its sides are two points here, no base and head."""
    told = finding.note.replace(" of a side", " of a point")
    return told.replace(" of base", " before").replace(" of head", " after")


def _many(change: Change, count: int) -> str:
    return plural(count, "other change") if change is Change.CHANGED else plural(count, change.value)


def _axes(events: list[Event]) -> str:
    return ", ".join(dict.fromkeys(event.axis.value for event in events))
