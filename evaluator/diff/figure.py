"""How a difference grows, as a picture: distances of bodies above, equal environments below."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gpusimbench.evaluator.diff.result import Change, Difference, Divergence, Growth
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.render.figures import palette, plot
from gpusimbench.evaluator.render.figures.svg import element, figure, number, open_path, text, title
from gpusimbench.evaluator.render.numbers import length
from gpusimbench.schemas.text import plural, printable

_WIDTH, _LEFT, _RIGHT = 640.0, 84.0, 20.0
_SIDE = _WIDTH - _LEFT - _RIGHT
_TOP, _UPPER, _GAP, _LOWER, _BOTTOM, _MARGIN = 44.0, 230.0, 30.0, 90.0, 46.0, 8.0
_HEIGHT = _TOP + _UPPER + _GAP + _LOWER + _BOTTOM
_MARKED_POINTS = 20  # of a line at most; more would hide the line

_STYLE = """
:root { LIGHT }
@media (prefers-color-scheme: dark) { :root { DARK } }
svg { background: var(--page); }
svg text { fill: var(--ink); font: 12px system-ui, sans-serif; }
svg .small { font-size: 10.5px; fill: var(--quiet); }
svg .mid { text-anchor: middle; }
svg .end { text-anchor: end; }
.axis, .frame { stroke: var(--quiet); stroke-width: 1; fill: none; }
.faint { stroke: var(--rule); stroke-width: 1; fill: none; }
.first { stroke: var(--alert); stroke-width: 1.5; stroke-dasharray: 4 3; fill: none; }
RULES
.line { fill: none; stroke-width: 2; }
"""


def figure_of(found: Difference) -> str:
    """An SVG file that follows the light or dark theme of where it is shown; empty where no difference was found."""
    if found.first is None:
        return ""
    times = _times(found)
    style = _STYLE.replace("LIGHT", palette.variables(dark=False)).replace("DARK", palette.variables(dark=True))
    series = _series(found.growth) if found.growth else []
    legend, below = plot.legend([(index, name) for index, name, _ in series], _LEFT, _HEIGHT, _SIDE)
    parts = [
        element("style", style.replace("RULES", palette.rules())),
        text(f"a: {found.a.label}, {found.a.file.name}", _LEFT, 16, class_="small"),
        text(f"b: {found.b.label}, {found.b.file.name}", _LEFT, 31, class_="small"),
        *_distances(found, times, series),
        *_equal(found, found.first, times),
        legend,
    ]
    said = (
        "Distance of bodies and number of equal pairs of environments against simulated time; the first difference is "
        f"at {found.first.time:g} s"
    )
    drawn = figure(_WIDTH, _HEIGHT + below + (_MARGIN if series else 0.0), said, *parts)
    return drawn.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1) + "\n"


def _times(found: Difference) -> tuple[float, float]:
    # both panels share the axis
    steps = found.splits.steps
    begin, end = steps.first * found.a.dt, steps.last * found.a.dt
    if found.growth:
        begin, end = min(begin, found.growth.times[0]), max(end, found.growth.times[-1])
    return (begin, end) if end > begin else (begin, begin + 1.0)


def _x(time: float, times: tuple[float, float]) -> float:
    return _LEFT + _SIDE * (time - times[0]) / (times[1] - times[0])


def _series(growth: Growth) -> list[tuple[int, str, Sequence[float | None]]]:
    # index, name and distance [m] at each step of the lines that have a point
    if growth.fallen and growth.max_not_fallen:
        # bodies in free fall move metres apart, and would press all others into a corner of the figure
        fallen = plural(growth.fallen, "fallen body", "fallen bodies")
        largest = [(f"max, 3D, without {fallen}", growth.max_not_fallen)]
    else:
        largest = [("max, 3D", growth.max_spatial), ("max, planar", growth.max_planar)]
    named = [*largest, ("median, 3D", growth.median_spatial), ("median, planar", growth.median_planar)]
    return [(index, name, values) for index, (name, values) in enumerate(named) if any(values)]


def _distances(
    found: Difference, times: tuple[float, float], series: Sequence[tuple[int, str, Sequence[float | None]]]
) -> list[str]:
    growth, bottom = found.growth, _TOP + _UPPER
    frame = plot.frame(_LEFT, _TOP, _SIDE, _UPPER)
    if not growth or not series:
        why = why_missing(growth) or "no recorded position differs"
        return [frame, text(f"no distances: {why}", _LEFT + _SIDE / 2, _TOP + _UPPER / 2, class_="mid")]
    positive = [d for _, _, values in series for d in values if d]
    low, high = min(positive) / 2, max(positive) * 2

    def y(distance: float) -> float:
        return bottom - _UPPER * math.log(distance / low) / math.log(high / low)

    parts = []
    for tick in plot.log_ticks(low, high):
        parts.append(element("line", x1=_LEFT, x2=_LEFT + _SIDE, y1=y(tick), y2=y(tick), class_="faint"))
        parts.append(plot.left(_LEFT, y(tick), length(tick)))
    for index, name, values in series:
        points = [(_x(t, times), y(d)) for t, d in zip(growth.times, values, strict=True) if d]
        marks = [plot.mark(index, *p) for p in points[:: -(-len(points) // _MARKED_POINTS)]]
        parts.append(element("g", title(printable(name)), plot.path(index, open_path(points)), *marks))
    return [frame, *parts, text("distance of bodies", 14, _TOP + _UPPER / 2, class_="mid", rotate=-90)]


def _equal(found: Difference, divergence: Divergence, times: tuple[float, float]) -> list[str]:
    top, bottom = _TOP + _UPPER + _GAP, _TOP + _UPPER + _GAP + _LOWER
    pairs = found.compared.n_env
    parts = [plot.frame(_LEFT, top, _SIDE, _LOWER)]
    parts += [plot.bottom(_x(t, times), bottom, plot.tick_label(t)) for t in plot.ticks(*times)]
    parts += [plot.left(_LEFT, bottom - _LOWER * share, f"{pairs * share:.0f}") for share in (0.0, 1.0)]
    parts.append(plot.path(0, _stairs(found.splits.agreeing, found.a.dt, times, pairs, bottom)))
    first = _x(divergence.time, times)
    if divergence.phase == "timed" and found.compared.hash_phase != "timed":  # the axis is that of the capture
        label = f"first difference: step {divergence.step_a} of the {divergence.phase} phase"
        return [*parts, text(label, _LEFT + 5, top - 10, class_="small"), *_titles(top, bottom)]
    parts.append(element("line", x1=first, x2=first, y1=_TOP, y2=bottom, class_="first"))
    before = first > _LEFT + _SIDE / 2
    label = f"first difference: step {divergence.step_a}, {divergence.time:g} s"
    parts.append(text(label, first + (-5 if before else 5), top - 10, class_="small end" if before else "small"))
    return [*parts, *_titles(top, bottom)]


def _titles(top: float, bottom: float) -> list[str]:
    return [
        text("equal env pairs", 14, top + _LOWER / 2, class_="mid", rotate=-90),
        text("simulated time [s]", _LEFT + _SIDE / 2, bottom + 36, class_="mid"),
    ]


def _stairs(changes: Sequence[Change], dt: float, times: tuple[float, float], pairs: int, bottom: float) -> str:
    data = ""
    for change in changes:
        x, y = _x(change.step * dt, times), bottom - _LOWER * change.count / pairs
        data += f"H{number(x)}V{number(y)}" if data else f"M{number(x)} {number(y)}"
    return f"{data}H{number(_LEFT + _SIDE)}"
