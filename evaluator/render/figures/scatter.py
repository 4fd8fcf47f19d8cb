"""Scatter of speed against divergence: a mark for each group with intervals on both axes, exact zeros in a strip."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.render.figures import axis, lines
from gpusimbench.evaluator.render.figures.placement import Box, place
from gpusimbench.evaluator.render.figures.svg import element, figure, number, text, title

_WIDTH, _HEIGHT = 560.0, 330.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 12.0, 10.0, 44.0
_ZERO = 46.0  # height of the strip of exact zeros: marks, and labels above and below them
_SIDE, _LOW = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _BOTTOM
_MARK = 6.0  # half the room of a mark
_ROOM = 0.06  # of the axes, around what is drawn
_LEAST = 3.0  # ratio of an axis's ends at least


@dataclass(frozen=True)
class Point:
    """One group.

    index       of its colour and mark; groups of one engine share it
    label       beside its mark; empty: it has none
    speed       [env-steps/s], positive
    divergence  distance, zero where it is exactly that
    speed_ci, divergence_ci  95 % intervals; None where there is none
    broken      whether its work was not done or mechanics do not hold: its mark is hollow
    said        for those who point at it
    """

    index: int
    label: str
    speed: float
    divergence: float
    speed_ci: tuple[float, float] | None = None
    divergence_ci: tuple[float, float] | None = None
    broken: bool = False
    said: str = ""


def scatter(
    points: Sequence[Point],
    *,
    across: str,
    up: str,
    across_tick: Callable[[float], str],
    up_tick: Callable[[float], str],
) -> str:
    """Divergence upwards against speed, both logarithmic; empty where there are no points.

    across, up            what the axes are, with their units
    across_tick, up_tick  label of a value on them

    Exact zeros stand in a strip of their own below the axis of divergence. A label that finds no room stands in the
    legend below, with its mark.
    """
    if not points:
        return ""
    x_of, y_of, columns, rows = _scales(points)
    places = [(x_of(p.speed), y_of(p.divergence)) for p in points]
    strip = any(p.divergence == 0 for p in points)
    marks = [Box(x - _MARK, y - _MARK, x + _MARK, y + _MARK) for x, y in places]
    whiskers = [box for p, at in zip(points, places, strict=True) for box in _whiskers(p, at, x_of, y_of)]
    frame = Box(_LEFT + 2, _TOP + 1, _LEFT + _SIDE - 2, _LOW - 1)
    placed = place(places, [p.label for p in points], marks=marks, whiskers=whiskers, frame=frame)
    without = [(p.index, p.label) for p, label in zip(points, placed, strict=True) if p.label and not label]
    legend, below = lines.legend(without, _LEFT, _HEIGHT + 2, _SIDE, marks_alone={index for index, _ in without})
    drawn = []
    for point, at, label in zip(points, places, placed, strict=True):
        drawn.append(_mark(point, at, x_of, y_of))
        if label and label.leader:
            data = f"M{number(at[0])} {number(at[1])}L{number(label.leader[0])} {number(label.leader[1])}"
            drawn.insert(0, element("path", d=data, class_="lead-out"))
        if label:
            # a grid line behind a label would strike it through
            over = "" if label.box.bottom > _LOW - _ZERO and strip else " over"
            drawn.append(text(point.label, label.box.left, label.box.bottom - 2.5, class_=f"name{over}"))
    return figure(
        _WIDTH,
        _HEIGHT + (below + 4 if below else 0),
        _words(points, across, up),
        element("rect", x=_LEFT, y=_LOW - _ZERO, width=_SIDE, height=_ZERO, class_="ground") if strip else "",
        *(element("line", x1=at, x2=at, y1=_TOP, y2=_LOW, class_="faint") for _, at in columns),
        *(element("line", x1=_LEFT, x2=_LEFT + _SIDE, y1=at, y2=at, class_="faint") for _, at in rows),
        axis.frame(_LEFT, _TOP, _SIDE, _LOW - _TOP),
        *(axis.bottom(at, _LOW, across_tick(v)) for v, at in columns),
        *(axis.left(_LEFT, at, up_tick(v)) for v, at in rows),
        text("exactly 0", _LEFT - 7, _LOW - _ZERO / 2 + 4, class_="end") if strip else "",
        text(across, _LEFT + _SIDE / 2, _LOW + 34, class_="mid"),
        text(up, 12, (_TOP + _LOW) / 2, class_="mid", rotate=-90),
        *drawn,
        legend,
    )


Scale = Callable[[float], float]
_Ticks = list[tuple[float, float]]


def _scales(points: Sequence[Point]) -> tuple[Scale, Scale, _Ticks, _Ticks]:
    """Places of speeds and divergences, and the ticks of both."""
    slow, fast = _span([v for p in points for v in (p.speed, *(p.speed_ci or ()))])
    floor = _LOW - (_ZERO if any(p.divergence == 0 for p in points) else 0.0)
    distances = [v for p in points for v in (p.divergence, *(p.divergence_ci or ())) if v > 0]
    near, far = _span(distances) if distances else (1.0, 10.0)

    def x_of(value: float) -> float:
        return _LEFT + _SIDE * math.log(max(value, slow) / slow) / math.log(fast / slow)

    def y_of(value: float) -> float:
        if value <= 0:
            return (floor + _LOW) / 2
        return _TOP + (floor - _TOP) * (1 - math.log(value / near) / math.log(far / near))

    columns = [(v, x_of(v)) for v in axis.log_ticks(slow, fast)]
    rows = [(v, y_of(v)) for v in axis.log_ticks(near, far)] if distances else []
    return x_of, y_of, columns, rows


def _span(values: Sequence[float]) -> tuple[float, float]:
    """An axis's ends: the positive values with some room, never nearly nothing between them."""
    positive = [v for v in values if v > 0]
    low, high = min(positive), max(positive)
    wider = math.sqrt(max(1.0, _LEAST / (high / low)))
    room = (high / low * wider**2) ** _ROOM * wider
    return low / room, high * room


def _whiskers(point: Point, at: tuple[float, float], x_of: Scale, y_of: Scale) -> list[Box]:
    """What the lines of both intervals cover."""
    x, y = at
    boxes = []
    if point.speed_ci:
        low, high = (x_of(v) for v in point.speed_ci)
        boxes.append(Box(low - 2, y - 3, high + 2, y + 3))
    if point.divergence_ci:
        top, bottom = sorted(y_of(v) for v in point.divergence_ci)
        boxes.append(Box(x - 3, top - 2, x + 3, bottom + 2))
    return boxes


def _mark(point: Point, at: tuple[float, float], x_of: Scale, y_of: Scale) -> str:
    x, y = at
    parts = [title(point.said or point.label)]
    colour = lines.colour_class(point.index)
    data = ""
    if point.speed_ci:
        low, high = (x_of(v) for v in point.speed_ci)
        data += f"M{number(low)} {number(y)}H{number(high)}"
        data += "".join(f"M{number(end)} {number(y - 3)}v6" for end in (low, high))
    if point.divergence_ci:
        low, high = (y_of(v) for v in point.divergence_ci)
        data += f"M{number(x)} {number(low)}V{number(high)}"
        data += "".join(f"M{number(x - 3)} {number(end)}h6" for end in (low, high))
    if data:
        parts.append(element("path", d=data, class_=f"{colour} whisker"))
    parts.append(lines.mark(point.index, x, y, hollow=point.broken))
    return element("g", *parts)


def _words(points: Sequence[Point], across: str, up: str) -> str:
    """The picture in a sentence for those who cannot see it."""
    said = f"{up} against {across} of {len(points)} {'group' if len(points) == 1 else 'groups'}"
    zero = list(dict.fromkeys(p.label for p in points if p.divergence == 0 and p.label))
    fastest = max(points, key=lambda p: (not p.broken, p.speed))
    if zero:
        said += f"; exactly 0: {', '.join(zero)}"
    if not fastest.broken:
        said += f"; fastest that is valid: {fastest.said or fastest.label}"
    return said
