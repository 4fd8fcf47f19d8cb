"""Scatter of speed against divergence: a mark for each group with intervals on both axes, exact zeros in a strip."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import element, figure, open_path, text, title, whisker_across, whisker_up

_WIDTH, _HEIGHT = 560.0, 330.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 12.0, 10.0, 44.0
_ZERO = 46.0  # height of the strip of exact zeros: marks, and labels above and below them
_SIDE, _LOW = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _BOTTOM
_MARK = 6.0  # half the room of a mark
_ROOM = 0.06  # of the axes, around what is drawn
_LEAST = 3.0  # ratio of an axis's ends at least

LETTER = 6.4
"""Width of a letter of a label at 11 px: more than most, for fonts differ."""

HEIGHT = 12.0

_BESIDE = 9.0  # from a point to a label that needs no line
_FAR = (22.0, 32.0, 44.0, 58.0, 74.0, 92.0, 112.0, 136.0)  # to one that has a line
_ANGLES = 16
_GAP = 2.0  # from the end of a line to its label


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
    legend, below = plot.legend(without, _LEFT, _HEIGHT + 2, _SIDE, marks_alone={index for index, _ in without})
    drawn = []
    for point, at, label in zip(points, places, placed, strict=True):
        drawn.append(_mark(point, at, x_of, y_of))
        if label and label.leader:
            drawn.insert(0, element("path", d=open_path([at, label.leader]), class_="lead-out"))
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
        plot.frame(_LEFT, _TOP, _SIDE, _LOW - _TOP),
        *(plot.bottom(at, _LOW, across_tick(v)) for v, at in columns),
        *(plot.left(_LEFT, at, up_tick(v)) for v, at in rows),
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

    columns = [(v, x_of(v)) for v in plot.log_ticks(slow, fast)]
    rows = [(v, y_of(v)) for v in plot.log_ticks(near, far)] if distances else []
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
    colour = plot.colour_class(point.index)
    data = ""
    if point.speed_ci:
        data += whisker_across(y, *map(x_of, point.speed_ci))
    if point.divergence_ci:
        data += whisker_up(x, *map(y_of, point.divergence_ci))
    if data:
        parts.append(element("path", d=data, class_=f"{colour} whisker"))
    parts.append(plot.mark(point.index, x, y, hollow=point.broken))
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


@dataclass(frozen=True)
class Box:
    """A rectangle in figure units."""

    left: float
    top: float
    right: float
    bottom: float

    def meets(self, other: Box) -> bool:
        """Whether both have an area in common."""
        return (
            self.left < other.right and other.left < self.right and self.top < other.bottom and other.top < self.bottom
        )

    def within(self, other: Box) -> bool:
        """Whether all of it lies in the other."""
        return (
            self.left >= other.left
            and self.right <= other.right
            and self.top >= other.top
            and self.bottom <= other.bottom
        )


@dataclass(frozen=True)
class Label:
    """Where a label stands.

    box     that its text fills; the text begins at its left edge
    leader  the end of a line from the point to the label; None where it stands beside its point
    """

    box: Box
    leader: tuple[float, float] | None = None


def place(
    points: Sequence[tuple[float, float]],
    texts: Sequence[str],
    *,
    marks: Sequence[Box],
    whiskers: Sequence[Box],
    frame: Box,
) -> list[Label | None]:
    """A place for the label of each point, in their order; None where there is no room, or no text.

    marks     that neither a label nor its line may cover
    whiskers  that no label may cover; its line may cross them
    frame     that every label lies in

    Points with the most others around them choose first. The same points give the same places.
    """
    order = sorted(range(len(points)), key=lambda i: (_room(i, points), i))
    found: list[Label | None] = [None] * len(points)
    solid, leaders = list(marks), list[Box]()
    for i in order:
        if not texts[i]:
            continue
        label = next(_free(points[i], len(texts[i]) * LETTER, solid, [*whiskers, *leaders], frame), None)
        if label:
            found[i] = label
            solid.append(label.box)
            leaders += _along(points[i], label.leader) if label.leader else []
    return found


def _room(i: int, points: Sequence[tuple[float, float]]) -> float:
    """Distance to the other points, the nearest counting most."""
    distances = sorted(math.dist(points[i], other) for j, other in enumerate(points) if j != i)
    return sum(d / 2.0**k for k, d in enumerate(distances))


def _free(
    point: tuple[float, float], width: float, solid: Sequence[Box], thin: Sequence[Box], frame: Box
) -> Iterator[Label]:
    for label in _candidates(point, width):
        if not label.box.within(frame) or any(label.box.meets(other) for other in (*solid, *thin)):
            continue
        if label.leader and any(part.meets(other) for part in _along(point, label.leader) for other in solid):
            continue
        yield label


def _candidates(point: tuple[float, float], width: float) -> Iterator[Label]:
    x, y = point
    near, half = _BESIDE, HEIGHT / 2
    for left, middle in (
        (x + near, y), (x - near - width, y), (x - width / 2, y - near - half), (x - width / 2, y + near + half),
        (x + near - 3, y - near), (x + near - 3, y + near), (x - near + 3 - width, y - near),
        (x - near + 3 - width, y + near),
    ):  # fmt: skip
        yield Label(Box(left, middle - half, left + width, middle + half))
    for far in _FAR:
        for step in range(_ANGLES):
            # from the upper right by turns to both sides
            angle = -math.pi / 4 + math.pi * 2 * (step + 1) // 2 * (-1) ** step / _ANGLES
            end = (x + far * math.cos(angle), y + far * math.sin(angle))
            left = end[0] + _GAP if math.cos(angle) >= 0 else end[0] - _GAP - width
            yield Label(Box(left, end[1] - half, left + width, end[1] + half), end)


def _along(point: tuple[float, float], end: tuple[float, float]) -> list[Box]:
    """Small boxes on a line, from beyond the point's mark to just before the label."""
    length = math.dist(point, end)
    steps = max(1, int((length - _BESIDE) / 3))
    shares = [(_BESIDE + (length - _BESIDE - 1) * i / steps) / length for i in range(steps)]
    at = [(point[0] + (end[0] - point[0]) * s, point[1] + (end[1] - point[1]) * s) for s in shares]
    return [Box(x - 1, y - 1, x + 1, y + 1) for x, y in at]
