"""Density map: where items ended up, as hexagons coloured by count, with a marginal along each side."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.metrics.density import Density, log_density
from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.palette import LEVELS, level
from gpusimbench.evaluator.render.figures.svg import closed_path, element, figure, number, open_path, text
from gpusimbench.evaluator.results.result import Map

_LEFT, _TOP, _BOTTOM, _SIDE, _GAP = 44.0, 14.0, 38.0, 44.0, 4.0
_WIDTH, _HEIGHT_LIMIT = 320.0, 420.0


@dataclass(frozen=True)
class Outline:
    """An axis-aligned rectangle in the map's frame [m]: x_min, x_max, y_min, y_max."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float


@dataclass(frozen=True)
class _Plane:
    """From metres to figure units; y points up in metres and down in the figure."""

    x_min: float
    y_max: float
    scale: float
    left: float
    top: float

    def x(self, metres: float) -> float:
        return self.left + (metres - self.x_min) * self.scale

    def y(self, metres: float) -> float:
        return self.top + (self.y_max - metres) * self.scale


def shares(counts: NDArray[np.int64], n_point: int) -> NDArray[np.float64]:
    """Marginal counts as shares of all positions, off the map included, shape [bin]."""
    return counts / max(n_point, 1)


def density_map(
    density: Density,
    marginals: tuple[NDArray[np.int64], NDArray[np.int64]],
    shared: Map,
    *,
    name: str,
    share_max: float,
    board: Outline | None = None,
) -> str:
    """One map on the scale that all maps of an evaluation share.

    density    counts per hexagon
    marginals  counts along x and y, shapes [bin] as `shared.edges` has them
    shared     grid, edges and the upper end of the colour scale
    name       of what is shown, for the picture's label
    share_max  upper end of both marginals: a share of all positions
    board      outline to draw, or None
    """
    x_min, x_max, y_min, y_max = shared.grid.extent_m
    scale = min(_WIDTH / (x_max - x_min), _HEIGHT_LIMIT / (y_max - y_min))
    width, height = scale * (x_max - x_min), scale * (y_max - y_min)
    plane = _Plane(x_min, y_max, scale, _LEFT, _TOP + _SIDE + _GAP)
    right, bottom = _LEFT + width, plane.top + height
    n_point = int(density.counts.sum()) + density.off_map
    along_x, along_y = (shares(counts, n_point) / (share_max or 1.0) for counts in marginals)
    bars_x = "".join(_bar_x(plane, shared.edges[0], i, v) for i, v in enumerate(along_x) if v > 0)
    bars_y = "".join(_bar_y(plane, right, shared.edges[1], i, v) for i, v in enumerate(along_y) if v > 0)
    return figure(
        right + _GAP + _SIDE + 18,
        bottom + _BOTTOM,
        f"Density map of {name}: {n_point:,} positions in {len(density.counts):,} hexagons, "
        f"{density.off_map:,} off the map",
        _outline(plane, board, shared.grid.extent_m) if board else "",
        _hexagons(plane, density, shared),
        element("path", d=bars_x, class_="bar") if bars_x else "",
        element("path", d=bars_y, class_="bar") if bars_y else "",
        plot.frame(_LEFT, plane.top, width, height),
        *(plot.bottom(plane.x(t), bottom, plot.tick_label(t)) for t in plot.ticks(x_min, x_max)),
        *(plot.left(_LEFT, plane.y(t), plot.tick_label(t)) for t in plot.ticks(y_min, y_max)),
        text("x [m]", _LEFT + width / 2, bottom + 32, class_="mid"),
        text(f"off the map: {density.off_map:,} of {n_point:,}", right + _GAP + _SIDE, bottom + 32, class_="small end")
        if density.off_map
        else "",
        text("y [m]", 11, plane.top + height / 2, class_="mid", rotate=-90),
        element("line", x1=_LEFT, x2=right, y1=plane.top - _GAP, y2=plane.top - _GAP, class_="axis"),
        element("line", x1=right + _GAP, x2=right + _GAP, y1=plane.top, y2=bottom, class_="axis"),
        text(_percent(share_max), right + _GAP, _TOP - 3, class_="small"),
        text(_percent(share_max), right + _GAP + _SIDE, bottom + 15, class_="mid small"),
        element("line", x1=_LEFT, x2=right, y1=_TOP, y2=_TOP, class_="faint"),
        element("line", x1=right + _GAP + _SIDE, x2=right + _GAP + _SIDE, y1=plane.top, y2=bottom, class_="faint"),
    )


def caption(density: Density) -> str:
    """What is seen, with the figures that a map hides."""
    shown, off = int(density.counts.sum()), density.off_map
    largest = int(density.counts.max()) if len(density.counts) else 0
    bins = len(density.counts)
    where = "all are on the map" if not off else f"{off:,} are off the map ({_percent(off / (shown + off))})"
    return (
        f"{shown + off:,} positions; {where}. {bins:,} {'hexagon is' if bins == 1 else 'hexagons are'} occupied, "
        f"the fullest holds {largest:,}."
    )


def count_scale(max_count: int) -> str:
    """The colour bar that all maps of an evaluation share: log10 of the count, from 0 to log10(max_count)."""
    width, height = 320.0, 12.0
    steps = [
        element("rect", x=20 + i * width / LEVELS, y=2, width=width / LEVELS + 0.3, height=height, class_=f"q{i} flat")
        for i in range(LEVELS)
    ]
    top = math.log10(max(max_count, 1))
    marks = [m for p in range(int(top) + 1) for m in (10**p, 2 * 10**p, 5 * 10**p) if m < max_count] + [max_count]
    places = {mark: 20 + width * (math.log10(mark) / top if top else 1.0) for mark in marks}
    ends = {marks[0], marks[-1]}
    labelled: list[int] = []
    for mark in sorted(places, key=lambda m: (m not in ends, math.log10(m) % 1, m)):  # ends first, then powers of ten
        room = min((abs(places[mark] - places[other]) for other in labelled), default=math.inf)
        if mark in ends or room >= 34:
            labelled.append(mark)
    labels = [plot.bottom(places[mark], 2 + height, f"{mark:,}") for mark in sorted(labelled)]
    name = f"Colour scale: 1 to {max_count:,} positions in a hexagon, logarithmic"
    return figure(width + 50, 36, name, *steps, *labels)


def _hexagons(plane: _Plane, density: Density, shared: Map) -> str:
    corners = shared.grid.corners()
    top = math.log10(max(shared.max_count, 1))
    paths: dict[int, list[str]] = {}
    for centre, value in zip(density.centres, log_density(density.counts), strict=True):
        points = [(plane.x(float(x)), plane.y(float(y))) for x, y in centre + corners]
        paths.setdefault(level(value / top) if top else LEVELS - 1, []).append(closed_path(points))
    return "".join(element("path", d="".join(paths[i]), class_=f"q{i} hex") for i in sorted(paths))


def _bar_x(plane: _Plane, edges: NDArray[np.float64], i: int, value: float) -> str:
    x, w = plane.x(edges[i]), (edges[i + 1] - edges[i]) * plane.scale
    high = min(value, 1.0) * _SIDE
    return f"M{number(x)} {number(plane.top - _GAP)}v{number(-high)}h{number(w)}v{number(high)}z"


def _bar_y(plane: _Plane, right: float, edges: NDArray[np.float64], i: int, value: float) -> str:
    y, h = plane.y(edges[i]), (edges[i + 1] - edges[i]) * plane.scale
    long = min(value, 1.0) * _SIDE
    return f"M{number(right + _GAP)} {number(y)}h{number(long)}v{number(-h)}h{number(-long)}z"


def _outline(plane: _Plane, board: Outline, extent: tuple[float, float, float, float]) -> str:
    """The part of the outline that lies on the map; its edges beyond the map are not drawn."""
    x_min, x_max, y_min, y_max = extent
    low_x, high_x = max(board.x_min, x_min), min(board.x_max, x_max)
    low_y, high_y = max(board.y_min, y_min), min(board.y_max, y_max)
    if not (low_x < high_x and low_y < high_y):
        return ""
    left, top = plane.x(low_x), plane.y(high_y)
    size = {"width": plane.x(high_x) - left, "height": plane.y(low_y) - top}
    area = element("rect", x=left, y=top, **size, class_="board")
    edges = [((x, low_y), (x, high_y)) for x in (board.x_min, board.x_max) if x_min < x < x_max]
    edges += [((low_x, y), (high_x, y)) for y in (board.y_min, board.y_max) if y_min < y < y_max]
    lines = "".join(open_path((plane.x(x), plane.y(y)) for x, y in ends) for ends in edges)
    return area + (element("path", d=lines, class_="edge") if lines else "")


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 0.0995 else f"{100 * share:.0f} %"
