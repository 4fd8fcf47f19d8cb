"""History: a quantity over points in time, with its intervals, its levels, and where it changed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import element, figure, number, open_path, text, title, whisker_up
from gpusimbench.schemas.text import plural

_WIDTH, _HEIGHT = 480.0, 250.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 84.0, 18.0, 40.0, 58.0
_SIDE, _FLOOR = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
_ROOM = 0.08  # of the axis, above and below what is drawn
_LETTER = 7.0
_LABEL = 16  # characters of a point's name that have room
_DECADES = 30.0  # from this ratio of the values on, the axis is logarithmic
_ROWS = 2  # of change labels above the frame


@dataclass(frozen=True)
class Dot:
    """A point in time: its place in the order, its value and interval."""

    at: int
    value: float
    low: float | None = None
    high: float | None = None
    said: str = ""


@dataclass(frozen=True)
class Mark:
    """A change: the first point with the new level, a few words, and whether it is to the worse."""

    at: int
    said: str
    worse: bool = False


@dataclass(frozen=True)
class Level:
    """A level between changes: from the first to the last point that has it."""

    first: int
    last: int
    value: float


def history_chart(
    dots: Sequence[Dot], names: Sequence[str], *, value: str, tick: Callable[[float], str],
    marks: Sequence[Mark] = (), levels: Sequence[Level] = (),
) -> str:  # fmt: skip
    """A curve over all points of a history; empty where there is nothing to draw.

    names  of all points, in order; those without a dot keep their place
    value  what the upward axis is, with its unit
    tick   label of a value on it
    """
    if not dots:
        return ""
    place_up, up_ticks = _upward(dots, levels)
    bottom, right = _TOP + _FLOOR, _LEFT + _SIDE

    def across(at: float) -> float:
        return _LEFT + _SIDE * (at + 0.5) / len(names)

    shown = _shown_names(names)
    said = f"{value} at {plural(len(dots), 'point')}, {plural(len(marks), 'change')} marked"
    return figure(
        _WIDTH,
        _HEIGHT,
        said,
        *(element("line", x1=_LEFT, x2=right, y1=place_up(v), y2=place_up(v), class_="faint") for v in up_ticks),
        plot.frame(_LEFT, _TOP, _SIDE, _FLOOR),
        *(plot.left(_LEFT, place_up(v), tick(v)) for v in up_ticks),
        *(_below(across(i), bottom, label) for i, label in shown),
        text("versions or commits, in order of recording", _LEFT + _SIDE / 2, bottom + 36, class_="mid small"),
        text(value, 12, _TOP + _FLOOR / 2, class_="mid", rotate=-90),
        *(
            element("path", d=f"M{number(across(level.first - 0.4))} {number(place_up(level.value))}"
                              f"H{number(across(level.last + 0.4))}", class_="fit")
            for level in levels
        ),
        plot.path(0, open_path((across(d.at), place_up(d.value)) for d in dots)),
        *(_dot(dot, across(dot.at), place_up) for dot in dots),
        *_marks(marks, across, bottom),
    )  # fmt: skip


def _upward(dots: Sequence[Dot], levels: Sequence[Level]) -> tuple[Callable[[float], float], list[float]]:
    """Where values stand, and the ticks; logarithmic where positive values span more than an ordinary axis can show."""
    ends = [v for d in dots for v in (d.value, d.low, d.high) if v is not None] + [level.value for level in levels]
    low, high = min(ends), max(ends)
    positive = [d.value for d in dots]
    if low > 0 and max(positive) / min(positive) >= _DECADES:
        room = (high / low) ** _ROOM
        low, high = low / room, high * room
        return (
            lambda v: _TOP + _FLOOR * (1 - math.log(v / low) / math.log(high / low)),
            plot.log_ticks(low, high, at_most=5),
        )
    room = (high - low) * _ROOM or abs(high) * _ROOM or 1.0
    # of quantities that are never negative, the axis is not either
    least = 0.0 if low >= 0 else -math.inf
    low, high = max(low - room, least), high + room
    return lambda v: _TOP + _FLOOR * (1 - (v - low) / (high - low)), plot.ticks(low, high, at_most=5)


def _shown_names(names: Sequence[str]) -> list[tuple[int, str]]:
    """Points whose names are shown: as many as have room side by side, the newest among them."""
    short = [name if len(name) <= _LABEL else f"{name[: _LABEL - 1]}…" for name in names]
    room = max(len(name) for name in short) * _LETTER + 10
    every = max(1, math.ceil(len(names) * room / _SIDE))
    return [(i, short[i]) for i in range(len(names) - 1, -1, -every)][::-1]


def _below(x: float, bottom: float, label: str) -> str:
    """A tick, and a point's name below it, which is moved to the side where it would leave the figure."""
    half = len(label) * _LETTER / 2
    line = element("line", x1=x, x2=x, y1=bottom, y2=bottom + 4, class_="axis")
    return line + text(label, min(max(x, half), _WIDTH - half), bottom + 15, class_="mid")


def _dot(dot: Dot, x: float, place_up: Callable[[float], float]) -> str:
    parts = [title(dot.said)] if dot.said else []
    if dot.low is not None and dot.high is not None:
        d = whisker_up(x, place_up(dot.low), place_up(dot.high))
        parts.append(element("path", d=d, class_=f"{plot.colour_class(0)} whisker"))
    return element("g", *parts, plot.mark(0, x, place_up(dot.value)))


def _marks(marks: Sequence[Mark], across: Callable[[float], float], bottom: float) -> list[str]:
    """A vertical line before the first point with a new level, and its words above the frame."""
    drawn, ends = [], [-math.inf] * _ROWS
    for mark in marks:
        x = across(mark.at - 0.5)
        wide = len(mark.said) * _LETTER
        begin = min(max(x - wide / 2, 0.0), _WIDTH - wide)
        row = next((i for i, end in enumerate(ends) if begin > end + 6), None)
        parts = [title(mark.said)]
        top = _TOP - 5
        if row is not None:
            ends[row] = begin + wide
            top = _TOP - 8 - 14 * row
            parts.append(text(mark.said, begin, top - 2, class_="small"))
        line = f"M{number(x)} {number(top)}V{number(bottom)}"
        parts.append(element("path", d=line, class_="cross" if mark.worse else "fit"))
        drawn.append(element("g", *parts))
    return drawn
