"""Numbers of a task over the steps of an environment, with the ends of episodes marked."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.svg import element, figure, open_path, text, title

MAX_BINS = 400
"""Stretches of a curve that are drawn; of a longer curve, the smallest and the largest value of each stretch."""

_WIDTH, _HEIGHT = 640.0, 190.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 66.0, 14.0, 10.0, 42.0
_SIDE, _UPRIGHT = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
_FEW = 30  # points that are marked one by one
_MOST = 1e100  # a file may hold any number; the difference of larger ones may be none

Scale = Callable[[float], float]


@dataclass(frozen=True)
class End:
    """Where an episode ends: at a step, terminated or else truncated."""

    step: int
    terminated: bool


def shown_rows(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of a curve that are drawn, in order; no extreme is left out, and no gap closed."""
    n = len(values)
    if n <= 2 * MAX_BINS:
        return np.arange(n)
    found = [0, n - 1]
    for rows in np.array_split(np.arange(n), MAX_BINS):
        part = values[rows]
        if np.isfinite(part).any():
            found += [int(rows[np.nanargmin(part)]), int(rows[np.nanargmax(part)])]
        found += rows[~np.isfinite(part)][:1].tolist()
    return np.unique(np.array(found, dtype=np.int64))


def shown_ends(ends: Sequence[End], first: float, last: float) -> list[End]:
    """Ends that are drawn between two steps: of more than MAX_BINS, the first of each kind in each stretch."""
    if len(ends) <= MAX_BINS:
        return list(ends)
    kept: dict[tuple[int, bool], End] = {}
    for end in ends:
        kept.setdefault((int(MAX_BINS * (end.step - first) / (last - first)), end.terminated), end)
    return list(kept.values())


def curves_chart(
    curves: Sequence[tuple[str, NDArray[np.float64]]], steps: NDArray[np.int64], ends: Sequence[End], *, name: str
) -> str:
    """A line for each curve; empty where no value is finite.

    curves  label and values, shape [row]; a value that is not finite, or beyond 1e100, opens the line
    steps   of the rows, ascending, shape [row]
    ends    of episodes: a dashed line where terminated, a dotted one where truncated; see shown_ends
    name    of the picture, for those who cannot see it
    """
    curves = [(label, np.where(np.abs(values) < _MOST, values, np.nan)) for label, values in curves]
    known = np.concatenate([values[np.isfinite(values)] for _, values in curves]) if curves else np.empty(0)
    if not known.size:
        return ""
    low, high = float(known.min()), float(known.max())
    pad = (high - low) * 0.05 or max(abs(high), 1.0) * 0.05
    low, high = low - pad, high + pad
    first, last = float(steps[0]), float(max(steps[-1], steps[0] + 1))

    def x(step: float) -> float:
        return _LEFT + _SIDE * (step - first) / (last - first)

    def y(value: float) -> float:
        return _TOP + _UPRIGHT * (high - value) / (high - low)

    low_edge = _TOP + _UPRIGHT
    named = [(index, label) for index, (label, _) in enumerate(curves)] if len(curves) > 1 else []
    long = {index for index, (_, values) in enumerate(curves) if len(shown_rows(values)) > _FEW}
    legend, height = plot.legend(named, _LEFT, _HEIGHT, _SIDE, lines_alone=long)
    ticks = plot.ticks(low, high, at_most=5) if high > low else []
    return figure(
        _WIDTH,
        _HEIGHT + height,
        name,
        *(element("line", x1=_LEFT, x2=_LEFT + _SIDE, y1=y(v), y2=y(v), class_="faint") for v in ticks),
        *(_end(end, x(end.step)) for end in shown_ends(ends, first, last)),
        plot.frame(_LEFT, _TOP, _SIDE, _UPRIGHT),
        *(plot.left(_LEFT, y(v), plot.tick_label(v)) for v in ticks),
        *(plot.bottom(x(s), low_edge, plot.tick_label(s)) for s in plot.ticks(first, last)),
        text("step", _LEFT + _SIDE / 2, low_edge + 34, class_="mid"),
        *(_line(index, *curve, steps, x, y) for index, curve in enumerate(curves)),
        legend,
    )


def _line(index: int, label: str, values: NDArray[np.float64], steps: NDArray[np.int64], x: Scale, y: Scale) -> str:
    rows = shown_rows(values)
    places = [
        (x(step), y(value)) if math.isfinite(value) else None
        for step, value in zip(steps[rows].tolist(), values[rows].tolist(), strict=True)
    ]
    data = open_path(places)
    marks = [plot.mark(index, *at) for at in places if at] if len(places) <= _FEW else []
    return element("g", title(label), plot.path(index, data), *marks) if data else ""


def _end(end: End, at: float) -> str:
    said = f"step {end.step}: {'terminated' if end.terminated else 'truncated'}"
    class_ = "edge" if end.terminated else "lead-out"
    return element("line", title(said), x1=at, x2=at, y1=_TOP, y2=_TOP + _UPRIGHT, class_=class_)
