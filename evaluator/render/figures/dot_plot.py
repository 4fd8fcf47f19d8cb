"""Dot plot: a value of each of several groups with its interval, sorted, exact zeros apart.

A group's name stands above its row: beside it, long names would leave no room for the values on a narrow screen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import element, figure, number, text, title, whisker_across

_WIDTH = 400.0
_LEFT, _RIGHT, _TOP, _ROW, _BOTTOM = 14.0, 22.0, 4.0, 29.0, 42.0
_NAME = 13.0  # height of a row's name; the values have the rest of the row
_ZERO = 30.0  # width of the strip of exact zeros beside a logarithmic axis
_LABEL = 60  # characters of a label that have room
_DECADES = 30.0  # from this ratio of the values on, the axis is logarithmic
_ROOM = 0.06


@dataclass(frozen=True)
class Dot:
    """One group.

    index  of its colour and mark
    label  beside its row
    value  not negative
    low, high  interval; None where there is none
    open   whether the value is a lower bound: nothing is known of how much larger it is
    said   for those who point at it
    """

    index: int
    label: str
    value: float
    low: float | None = None
    high: float | None = None
    open: bool = False
    said: str = ""


def is_logarithmic(dots: Sequence[Dot]) -> bool:
    """Whether the values that are not zero span more than an ordinary axis can show."""
    positive = [d.value for d in dots if d.value > 0]
    return len(positive) > 1 and max(positive) / min(positive) >= _DECADES


def dot_plot(dots: Sequence[Dot], *, value: str, tick: Callable[[float], str], best_first: bool = True) -> str:
    """A row for each dot, in ascending order of the values, or descending where larger is better.

    value       what the axis is, with its unit
    tick        label of a value on it
    best_first  False where small values are best: they stand first then as well, so best is always on top
    """
    if not dots:
        return ""
    rows = sorted(dots, key=lambda d: (-d.value if best_first else d.value, d.label))
    scale = _logarithmic(rows) if is_logarithmic(rows) else _linear(rows)
    bottom = _TOP + _ROW * len(rows)
    right = _WIDTH - _RIGHT
    ticks = [(v, scale.place(v)) for v in scale.ticks]
    bands = [(_TOP + _ROW * i + _NAME + 2, _TOP + _ROW * (i + 1)) for i in range(len(rows))]
    strips = [
        element("rect", x=_LEFT, y=top, width=_ZERO, height=end - top, class_="ground")
        for top, end in bands
        if scale.strip
    ]
    grid = "".join(f"M{number(x)} {number(top)}V{number(end)}" for _, x in ticks for top, end in bands)
    grid += "".join(f"M{number(_LEFT)} {number((top + end) / 2)}H{number(right)}" for top, end in bands)
    return figure(
        _WIDTH,
        bottom + _BOTTOM,
        f"{value} of {len(rows)} groups, sorted; best on top",
        *strips,
        element("path", d=grid, class_="faint"),
        element("line", x1=_LEFT, x2=right, y1=bottom, y2=bottom, class_="axis"),
        plot.bottom(_LEFT + _ZERO / 2, bottom, "0") if scale.strip else "",
        *(plot.bottom(x, bottom, tick(v)) for v, x in ticks),
        text(value, (_LEFT + right) / 2, bottom + 33, class_="mid"),
        *(_row(dot, sum(band) / 2, scale) for dot, band in zip(rows, bands, strict=True)),
    )


@dataclass(frozen=True)
class _Scale:
    """Where values stand; `strip` says that exact zeros have a place of their own, left of `begin`."""

    place: Callable[[float], float]
    ticks: Sequence[float]
    begin: float
    strip: bool


def _linear(dots: Sequence[Dot]) -> _Scale:
    high = max(max(d.value, d.high or 0.0) for d in dots) or 1.0
    high *= 1 + _ROOM
    begin, side = _LEFT, _WIDTH - _RIGHT - _LEFT
    ticks = plot.ticks(0.0, high, at_most=5)
    if all(d.value == round(d.value) and d.low is None for d in dots):
        ticks = [t for t in ticks if t == round(t)]  # of what is counted there is no half
    return _Scale(lambda v: begin + side * v / high, ticks, begin, strip=False)


def _logarithmic(dots: Sequence[Dot]) -> _Scale:
    values = [v for d in dots for v in (d.value, d.low, d.high) if v is not None and v > 0]
    room = (max(values) / min(values)) ** _ROOM
    low, high = min(values) / room, max(values) * room
    if any(d.open for d in dots):
        high *= room  # for its arrow
    strip = any(d.value == 0 for d in dots)
    begin = _LEFT + (_ZERO if strip else 0.0)
    side = _WIDTH - _RIGHT - begin

    def place(value: float) -> float:
        if value <= 0:
            return _LEFT + _ZERO / 2 if strip else _LEFT
        return begin + side * math.log(value / low) / math.log(high / low)

    return _Scale(place, plot.log_ticks(low, high, at_most=5), begin, strip)


def _row(dot: Dot, y: float, scale: _Scale) -> str:
    x = scale.place(dot.value)
    parts = [title(dot.said or dot.label)]
    colour = plot.colour_class(dot.index)
    if dot.low is not None and dot.high is not None:
        low, high = max(scale.place(dot.low), scale.begin if dot.value > 0 else _LEFT), scale.place(dot.high)
        parts.append(element("path", d=whisker_across(y, low, high, 4), class_=f"{colour} whisker"))
    if dot.open:
        parts.append(element("path", d=f"M{number(x)} {number(y)}h16m-5 -4l5 4l-5 4", class_=f"{colour} whisker"))
    if dot.value == 0:
        parts.append(element("circle", cx=x, cy=y, r=4.2, class_=f"{colour} nothing"))
    else:
        parts.append(plot.mark(dot.index, x, y))
    label = dot.label if len(dot.label) <= _LABEL else f"{dot.label[: _LABEL - 1]}…"
    parts.append(text(label, _LEFT, y - (_ROW - _NAME) / 2 - 2, class_="name"))
    return element("g", *parts)
