"""Radar: six axes scaled over the groups compared, a line per group."""

from __future__ import annotations

import math

from gpusimbench.evaluator.metrics.radar import Axis, Radar
from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import closed_path, element, figure, open_path, text

AT_MOST = 8
"""Groups on one radar: as many as there are colours; more outlines cannot be told apart."""

_WIDTH, _HEIGHT, _RADIUS = 370.0, 310.0, 100.0
_RINGS = (0.25, 0.5, 0.75, 1.0)


def radar_chart(radar: Radar) -> str:
    """All groups on one radar: 1 (best of these) at the rim, 0 (worst of these) in the middle.

    An axis that a group was not measured on has no mark, and the group's outline is open there: a gap is no zero.
    """
    axes = list(Axis)
    middle = (_WIDTH / 2, _HEIGHT / 2)
    spokes = [
        element("line", x1=middle[0], y1=middle[1], x2=x, y2=y, class_="faint")
        for x, y in (_at(i, 1.0) for i in range(len(axes)))
    ]
    rings = [element("path", d=closed_path(_at(i, r) for i in range(len(axes))), class_="faint ring") for r in _RINGS]
    drawn = [_line(i, [values[axis] for axis in axes]) for i, values in enumerate(radar.values.values())]
    legend, below = plot.legend(list(enumerate(radar.values)), 10, _HEIGHT + 4, _WIDTH - 20)
    return figure(
        _WIDTH,
        _HEIGHT + below + 6,
        f"Radar of {len(radar.values)} groups on {len(axes)} axes; the values stand in the table beside it",
        *rings,
        *spokes,
        *drawn,
        *(_label(i, axis, radar) for i, axis in enumerate(axes)),
        legend,
    )


def _at(index: int, value: float) -> tuple[float, float]:
    """Place of a value on an axis; the first axis points up, the others follow clockwise."""
    angle = 2 * math.pi * index / len(Axis) - math.pi / 2
    return _WIDTH / 2 + _RADIUS * value * math.cos(angle), _HEIGHT / 2 + _RADIUS * value * math.sin(angle)


def _line(index: int, values: list[float | None]) -> str:
    """A closed outline, or the parts of it whose both ends were measured."""
    parts = []
    for i, value in enumerate(values):
        following = values[(i + 1) % len(values)]
        if value is not None and following is not None:
            parts.append(open_path([_at(i, value), _at((i + 1) % len(values), following)]))
    whole = [v for v in values if v is not None]
    if len(whole) == len(values):
        parts = [closed_path(_at(i, v) for i, v in enumerate(whole))]
    path = (
        element("path", d="".join(parts), class_=plot.line_class(index), stroke_dasharray=plot.dash(index))
        if parts
        else ""
    )
    return path + "".join(plot.mark(index, *_at(i, v)) for i, v in enumerate(values) if v is not None)


def _label(index: int, axis: Axis, radar: Radar) -> str:
    """An axis's name outside the rim, a word a line, with a remark where its values say nothing."""
    measured = any(values[axis] is not None for values in radar.values.values())
    remark = "not measured" if not measured else "no difference" if axis in radar.all_equal else ""
    x, y = _at(index, 1.12)
    side = "mid" if abs(x - _WIDTH / 2) < 1 else "" if x > _WIDTH / 2 else "end"
    lines = [axis.value] if side == "mid" else axis.value.rsplit(" ", 1)
    height = 14.0 * (len(lines) + bool(remark))
    top = y - height if side == "mid" and y < _HEIGHT / 2 else y if side == "mid" else y - height / 2
    drawn = [text(line, x, top + 14.0 * i + 11, class_=side) for i, line in enumerate(lines)]
    if remark:
        drawn.append(text(remark, x, top + 14.0 * len(lines) + 10, class_=f"small {side}".strip()))
    return "".join(drawn)
