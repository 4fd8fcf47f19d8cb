"""How a difference grows, as a picture: distances of bodies above, equal environments below."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gpusimbench.evaluator.diff.result import Change, Difference, Divergence
from gpusimbench.evaluator.missing import why_missing
from gpusimbench.evaluator.render.figures import axis, lines, palette
from gpusimbench.evaluator.render.figures.svg import element, figure, number, open_path, text, title
from gpusimbench.schemas.text import printable

_WIDTH, _LEFT, _RIGHT = 640.0, 84.0, 20.0
_SIDE = _WIDTH - _LEFT - _RIGHT
_TOP, _UPPER, _GAP, _LOWER, _BOTTOM = 44.0, 230.0, 30.0, 90.0, 46.0
_HEIGHT = _TOP + _UPPER + _GAP + _LOWER + _BOTTOM
_MARKS = ((1e-3, "1 mm"), (1e-2, "1 cm"))
_MARKED_POINTS = 40  # more would hide the line

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
    parts = [
        element("style", style.replace("RULES", palette.rules())),
        text(f"a: {found.a.label}, {found.a.path.name}", _LEFT, 16, class_="small"),
        text(f"b: {found.b.label}, {found.b.path.name}", _LEFT, 31, class_="small"),
        *_distances(found, times),
        *_equal(found, found.first, times),
    ]
    said = (
        "Distance of bodies and number of equal pairs of environments against simulated time; the first difference is "
        f"at {found.first.time:g} s"
    )
    drawn = figure(_WIDTH, _HEIGHT, said, *parts)
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


def _distances(found: Difference, times: tuple[float, float]) -> list[str]:
    growth, bottom = found.growth, _TOP + _UPPER
    frame = axis.frame(_LEFT, _TOP, _SIDE, _UPPER)
    series = (
        [("max, 3D", growth.max_spatial), ("max, planar", growth.max_planar),
         ("median, 3D", growth.median_spatial), ("median, planar", growth.median_planar)]
        if growth else []
    )  # fmt: skip
    positive = [d for _, values in series for d in values if d]
    if not growth or not positive:
        why = why_missing(growth) or "no recorded position differs"
        return [frame, text(f"no distances: {why}", _LEFT + _SIDE / 2, _TOP + _UPPER / 2, class_="mid")]
    low, high = min(*positive, 1e-4) / 2, max(*positive, 1e-2) * 2

    def y(distance: float) -> float:
        return bottom - _UPPER * math.log(distance / low) / math.log(high / low)

    parts = []
    for tick in axis.log_ticks(low, high):
        parts.append(element("line", x1=_LEFT, x2=_LEFT + _SIDE, y1=y(tick), y2=y(tick), class_="faint"))
        parts.append(axis.left(_LEFT, y(tick), f"{tick:g}"))
    for size, name in _MARKS:
        parts.append(text(name, _LEFT + _SIDE - 4, y(size) - 3, class_="small end over"))
    for index, (name, values) in enumerate(series):
        points = [(_x(t, times), y(d)) for t, d in zip(growth.times, values, strict=True) if d]
        if points:
            marks = [lines.mark(index, *p) for p in points] if len(points) <= _MARKED_POINTS else []
            parts.append(element("g", title(printable(name)), lines.path(index, open_path(points)), *marks))
        place = _LEFT + 10, _TOP + 16 + 16 * index
        parts.append(lines.path(index, f"M{number(place[0])} {number(place[1])}h26"))
        parts.append(lines.mark(index, place[0] + 13, place[1]))
        parts.append(text(name, place[0] + 34, place[1] + 4, class_="small over"))
    return [frame, *parts, text("distance [m]", 14, _TOP + _UPPER / 2, class_="mid", rotate=-90)]


def _equal(found: Difference, divergence: Divergence, times: tuple[float, float]) -> list[str]:
    top, bottom = _TOP + _UPPER + _GAP, _TOP + _UPPER + _GAP + _LOWER
    pairs = found.compared.n_env
    parts = [axis.frame(_LEFT, top, _SIDE, _LOWER)]
    parts += [axis.bottom(_x(t, times), bottom, axis.tick_label(t)) for t in axis.ticks(*times)]
    parts += [axis.left(_LEFT, bottom - _LOWER * share, f"{pairs * share:.0f}") for share in (0.0, 1.0)]
    parts.append(lines.path(0, _stairs(found.splits.agreeing, found.a.dt, times, pairs, bottom)))
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
        text("equal pairs", 14, top + _LOWER / 2, class_="mid", rotate=-90),
        text("simulated time [s]", _LEFT + _SIDE / 2, bottom + 36, class_="mid"),
    ]


def _stairs(changes: Sequence[Change], dt: float, times: tuple[float, float], pairs: int, bottom: float) -> str:
    data = ""
    for change in changes:
        x, y = _x(change.step * dt, times), bottom - _LOWER * change.count / pairs
        data += f"H{number(x)}V{number(y)}" if data else f"M{number(x)} {number(y)}"
    return f"{data}H{number(_LEFT + _SIDE)}"
