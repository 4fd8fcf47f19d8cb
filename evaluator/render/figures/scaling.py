"""Scaling: a figure of simulators against the number of environments, both axes logarithmic."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import closed_path, element, figure, number, open_path, text, title
from gpusimbench.schemas.text import plural

LINE_FROM = 4
"""Points of a sweep from which on a line joins them: fewer do not show what lies between."""

_WIDTH, _HEIGHT = 480.0, 330.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 76.0, 16.0, 14.0, 44.0
_SIDE, _FLOOR = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
_MODEL_POINTS = 48
_ROOM = 0.05  # of the axes, around what is drawn
_CLOSE = 13.0  # two labels nearer than that are moved apart

Point = tuple[float, float]


@dataclass(frozen=True)
class Curve:
    """One sweep.

    index   of its colour, dash and mark
    label   for those who point at it
    points  (environments, value), in order of environments, all positive
    model   value at a number of environments, drawn as a thin line where it is positive; None: no such line
    ideal   whether N environments should have N times the value of one: the line through the first point is drawn
    n_max   N_env^max, ringed; None where no point is
    failed  the number of environments beyond it at which no run was complete, crossed; None where none was tried
    ends    why the curve ends, in words
    """

    index: int
    label: str
    points: tuple[Point, ...]
    model: Callable[[float], float] | None = None
    ideal: bool = False
    n_max: int | None = None
    failed: int | None = None
    ends: str = ""


@dataclass(frozen=True)
class Foreign:
    """A single point that somebody else published: its name, environments and value."""

    label: str
    n_env: float
    value: float


def scaling_chart(
    curves: Sequence[Curve], *, value: str, tick: Callable[[float], str], foreign: Sequence[Foreign] = ()
) -> str:
    """Curves of a value against the number of environments; empty where there is nothing to draw.

    value  what the upward axis is, for example "throughput [env-steps/s]"
    tick   label of a value on it
    """
    drawn = [p for c in curves for p in c.points] + [(f.n_env, f.value) for f in foreign]
    if not drawn:
        return ""
    across = _span([n for n, _ in drawn] + [float(c.failed) for c in curves if c.failed])
    up = _span([v for _, v in drawn])

    def place(n_env: float, height: float) -> Point:
        return (
            _LEFT + _SIDE * _share(n_env, across),
            _TOP + _FLOOR * (1 - _share(min(max(height, up[0]), up[1]), up)),
        )

    bottom, right = _TOP + _FLOOR, _LEFT + _SIDE
    columns = [(n, place(n, up[0])[0]) for n in plot.power_ticks(*across)]
    rows = [(v, place(across[0], v)[1]) for v in plot.log_ticks(*up)]
    named = [(curve.index, f"{curve.label}{_largest(curve)}") for curve in curves if curve.points]
    few = {curve.index for curve in curves if len(curve.points) < LINE_FROM}
    legend, below = plot.legend(named, _LEFT, _HEIGHT + 2, _SIDE, marks_alone=few)
    said = f"{value} against the number of environments: {len(curves)} sweeps; the values stand in the table below"
    return figure(
        _WIDTH,
        _HEIGHT + below + 4,
        said,
        *(element("line", x1=x, x2=x, y1=_TOP, y2=bottom, class_="faint") for _, x in columns),
        *(element("line", x1=_LEFT, x2=right, y1=y, y2=y, class_="faint") for _, y in rows),
        plot.frame(_LEFT, _TOP, _SIDE, _FLOOR),
        *(plot.bottom(x, bottom, f"{n:,}") for n, x in columns),
        *(plot.left(_LEFT, y, tick(v)) for v, y in rows),
        text("environments", _LEFT + _SIDE / 2, bottom + 34, class_="mid"),
        text(value, 12, _TOP + _FLOOR / 2, class_="mid", rotate=-90),
        *(_curve(curve, place, up[1]) for curve in sorted(curves, key=lambda c: len(c.points) < LINE_FROM)),
        *_foreign(foreign, place),
        legend,
    )


def _span(values: Sequence[float]) -> Point:
    """The axis's ends: the values with some room, and never nothing between them."""
    low, high = min(values), max(values)
    room = max((high / low) ** _ROOM, 1.2)
    return low / room, high * room


def _share(value: float, span: Point) -> float:
    return math.log(value / span[0]) / math.log(span[1] / span[0])


def _curve(curve: Curve, place: Callable[[float, float], Point], top: float) -> str:
    if not curve.points:
        return ""
    parts = [title(f"{curve.label}: {curve.ends}" if curve.ends else curve.label)]
    if len(curve.points) >= LINE_FROM:
        if curve.ideal:
            parts.append(_ideal(curve.points, place, top))
        if curve.model:
            parts.append(_model(curve.index, curve.points, curve.model, place))
        parts.append(plot.path(curve.index, open_path(place(*p) for p in curve.points)))
    parts += [plot.mark(curve.index, *place(*p)) for p in curve.points]
    last = next((p for p in curve.points if p[0] == curve.n_max), None)
    if last:
        x, y = place(*last)
        parts.append(element("circle", cx=x, cy=y, r=7.5, class_=f"{plot.colour_class(curve.index)} end-ring"))
        if curve.failed:
            end = place(curve.failed, last[1])[0]
            cross = f"M{number(end - 4)} {number(y - 4)}l8 8m0 -8l-8 8"
            parts.append(element("path", d=f"M{number(x + 8)} {number(y)}H{number(end - 5)}", class_="lead-out"))
            parts.append(element("path", d=cross, class_="cross"))
    return element("g", *parts)


def _largest(curve: Curve) -> str:
    """What the legend says of N_env^max."""
    if curve.n_max is None:
        return ""
    return f", {'max' if curve.failed else 'no failure up to'} {plural(curve.n_max, 'env', spec=',')}"


def _ideal(points: Sequence[Point], place: Callable[[float, float], Point], top: float) -> str:
    """Proportional scaling from the first point to the last, or to the upper end of the axis."""
    (first, value), (last, _) = points[0], points[-1]
    last = min(last, first * top / value)
    return element("path", d=open_path([place(first, value), place(last, value * last / first)]), class_="ideal")


def _model(
    index: int, points: Sequence[Point], model: Callable[[float], float], place: Callable[[float, float], Point]
) -> str:
    low, high = math.log(points[0][0]), math.log(points[-1][0])
    sampled = [math.exp(low + (high - low) * i / _MODEL_POINTS) for i in range(_MODEL_POINTS + 1)]
    shown = [place(n, value) for n in sampled if (value := model(n)) > 0]
    return element("path", d=open_path(shown), class_=f"{plot.colour_class(index)} model") if len(shown) > 1 else ""


def _foreign(foreign: Sequence[Foreign], place: Callable[[float, float], Point]) -> list[str]:
    drawn, taken = [], list[Point]()
    for one in sorted(foreign, key=lambda f: -f.value):
        x, y = place(one.n_env, one.value)
        diamond = closed_path([(x, y - 5), (x + 5, y), (x, y + 5), (x - 5, y)])
        drawn.append(element("path", title(f"{one.label}, published"), d=diamond, class_="foreign"))
        before = x > _LEFT + _SIDE * 0.7  # a label on the right would leave the frame
        height = y + 4
        while any(abs(height - other) < _CLOSE and abs(x - at) < 110 for at, other in taken):
            height += 2
        taken.append((x, height))
        drawn.append(
            text(one.label, x - 8 if before else x + 8, height, class_=f"small foreign-name{' end' if before else ''}")
        )
    return drawn
