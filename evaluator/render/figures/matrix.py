"""Consistency matrix: distances between environments or runs, cell by cell."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpusimbench.evaluator.render.figures import plot
from gpusimbench.evaluator.render.figures.palette import LEVELS, level
from gpusimbench.evaluator.render.figures.svg import element, figure, number, text, title
from gpusimbench.evaluator.render.numbers import distance

LARGEST = 128
"""Rows that are drawn at most; larger matrices are drawn in blocks."""

_DECADES = 6.0  # of the colour scale at most: what is smaller has its lowest colour
_CLOSE = 13.0  # labels of the scale nearer than that are left out
_NAMED = 20
_LEFT, _TOP = 48.0, 18.0
_LETTER = 9.0  # width of a class that has room for its letter
_SIDE_LEAST, _SIDE_LIMIT = 128.0, 280.0


@dataclass(frozen=True)
class Scale:
    """A logarithmic scale of colours, from the smallest to the largest distance that is not zero [cm]."""

    low: float
    high: float

    def share(self, value: float) -> float:
        """Where on the scale a distance lies, from 0 to 1; 1 where the scale has one value alone."""
        if self.low == self.high:
            return 1.0
        return min(1.0, max(0.0, math.log(value / self.low) / math.log(self.high / self.low)))


def scale_of(matrices: Iterable[NDArray[np.float64]]) -> Scale | None:
    """The scale that all of some matrices [cm] are drawn on; None where none has a finite distance above zero."""
    found = [m[np.isfinite(m) & (m > 0)] for m in matrices]
    positive = np.concatenate([f for f in found if f.size] or [np.zeros(0)])
    if not positive.size:
        return None
    high = float(positive.max())
    return Scale(max(float(positive.min()), high / 10**_DECADES), high)


def in_blocks(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """A matrix of at most LARGEST rows, and the edge of the blocks whose largest value each cell holds.

    matrix  [cm], shape [n, n]

    A block that holds a value that is not finite is not finite either: nothing bad is hidden.
    """
    n = len(matrix)
    block = -(-n // LARGEST)
    if block <= 1:
        return matrix, 1
    starts = np.arange(0, n, block)
    rows = np.maximum.reduceat(matrix, starts, axis=0)
    return np.asarray(np.maximum.reduceat(rows, starts, axis=1)), block


def by_class(classes: Sequence[int]) -> NDArray[np.int64]:
    """Places of rows ordered so that those of a class stand together, classes and their members by first place."""
    return np.argsort(np.asarray(classes), kind="stable").astype(np.int64)


def grouped(n: int, classes: Sequence[int]) -> bool:
    """Whether classes put rows together: neither all alike nor all different, and the rows are drawn one by one."""
    return len(classes) == n and 1 < len(set(classes)) < n <= LARGEST


def letter(number: int) -> str:
    """Name of a class: A to Z, then AA, AB, ..."""
    name = ""
    while number >= 0:
        name = chr(ord("A") + number % 26) + name
        number = number // 26 - 1
    return name


def matrix_map(
    matrix: NDArray[np.float64],
    *,
    of: str,
    name: str,
    classes: Sequence[int] = (),
    names: Sequence[int] | None = None,
    scale: Scale | None = None,
) -> str:
    """Heat map on a logarithmic scale of colours.

    matrix   [cm], shape [n, n]; the diagonal is zero by definition and left blank
    of       what rows and columns are: "env" or "run"
    name     of the group, for the picture's label
    classes  of the rows by their bits, numbered in order of first appearance; where they put rows together (see
             `grouped`), rows and columns are ordered by them, with a line between classes and a letter above each
    names    of the rows, as readers know them; their places where it is None
    scale    that it shares with other matrices; its own where it is None

    Cells that are exactly zero are hatched in a grey outside the scale (see `hatch`); the smallest nonzero value is the
    scale's lowest colour. Cells that are not finite have a red edge.
    """
    values = np.asarray(matrix, dtype=np.float64)
    order = by_class(classes) if grouped(len(values), classes) else np.arange(len(values))
    drawn, block = in_blocks(values[np.ix_(order, order)])
    n = len(drawn)
    shown = [names[i] if names is not None else i for i in order.tolist()]
    side = min(_SIDE_LIMIT, max(_SIDE_LEAST, 36.0 * n))
    size = side / max(n, 1)
    scale = scale or scale_of([drawn])
    kinds = _kinds(drawn, scale, blank_diagonal=block == 1)
    cells = _titled(kinds, drawn, size, of, shown) if n <= _NAMED else _merged(kinds, size)
    bottom = _TOP + side
    # rows out of order are named one by one, as far as there is room
    ticks = range(0, n, -(-n // _NAMED)) if grouped(len(values), classes) else plot.index_ticks(n)
    middles = [(str(shown[i * block]), (i + 0.5) * size) for i in ticks]
    return figure(
        _LEFT + side + 106,
        bottom + 38,
        f"Matrix of distances between {of}s of {name}. {caption(matrix, of=of)}",
        *cells,
        plot.frame(_LEFT, _TOP, side, side),
        *(plot.left(_LEFT, _TOP + at, label) for label, at in middles),
        *(plot.bottom(_LEFT + at, bottom, label) for label, at in middles),
        text(of, _LEFT + side / 2, bottom + 32, class_="mid"),
        text(of, 11, _TOP + side / 2, class_="mid", rotate=-90),
        *(_boundaries([classes[i] for i in order], size, side) if grouped(len(values), classes) else ()),
        *_bar(scale, side),
    )


def _boundaries(classes: Sequence[int], size: float, side: float) -> list[str]:
    """A line between classes, and the letter of each where there is room."""
    starts = [i for i in range(len(classes)) if i == 0 or classes[i] != classes[i - 1]]
    drawn = []
    for start, end in zip(starts, [*starts[1:], len(classes)], strict=True):
        at, width = start * size, (end - start) * size
        if start:
            drawn.append(element("line", x1=_LEFT + at, x2=_LEFT + at, y1=_TOP - 4, y2=_TOP + side, class_="boundary"))
            drawn.append(element("line", x1=_LEFT, x2=_LEFT + side, y1=_TOP + at, y2=_TOP + at, class_="boundary"))
        if width >= _LETTER:
            drawn.append(text(letter(classes[start]), _LEFT + at + width / 2, _TOP - 6, class_="small mid"))
    return drawn


def hatch() -> str:
    """The pattern of exact zeros, once for a page; its style sheet fills the class "zero" with it."""
    lines = element("path", d="M-1 1l2 -2M0 6l6 -6M5 7l2 -2", class_="hatch")
    ground = element("rect", width=6, height=6, class_="ground")
    pattern = element("pattern", ground, lines, id="hatch", width=6, height=6, patternUnits="userSpaceOnUse")
    return element("svg", element("defs", pattern), width=0, height=0, aria_hidden="true", class_="unseen")


def caption(matrix: NDArray[np.float64], *, of: str) -> str:
    """What is seen: the range, the exact zeros, and whether cells are blocks."""
    values = np.asarray(matrix, dtype=np.float64)
    n = len(values)
    pairs = values[np.triu_indices(n, k=1)]
    finite = pairs[np.isfinite(pairs)]
    nonzero = finite[finite != 0]
    zeros, lost = len(finite) - len(nonzero), len(pairs) - len(finite)
    said = [f"{len(pairs):,} {'pair' if len(pairs) == 1 else 'pairs'} of {of}s."]
    if len(pairs) and zeros == len(pairs):
        said.append("Every distance is exactly 0 (hatched).")
    elif zeros:
        said.append(f"Exactly 0 (hatched): {zeros:,}.")
    if len(nonzero):
        low, high = distance(float(nonzero.min())), distance(float(nonzero.max()))
        said.append(f"Nonzero: {len(nonzero):,}, " + (f"{low} cm." if low == high else f"from {low} to {high} cm."))
    if lost:
        said.append(f"Not finite (red edge): {lost:,}.")
    drawn, block = in_blocks(values)
    if block > 1:
        said.append(
            f"{n:,} × {n:,} cells are drawn as {len(drawn)} × {len(drawn)} blocks of {block} × {block}, each coloured "
            "by its largest value."
        )
    return " ".join(said)


def _kinds(matrix: NDArray[np.float64], scale: Scale | None, *, blank_diagonal: bool) -> list[list[str]]:
    """The class of every cell; empty where nothing is drawn."""
    rows = []
    for i, row in enumerate(matrix.tolist()):
        kinds = []
        for j, value in enumerate(row):
            if i == j and blank_diagonal:
                kinds.append("")
            elif not np.isfinite(value):
                kinds.append("lost")
            else:
                kinds.append("zero" if value == 0 or scale is None else f"q{level(scale.share(value))} flat")
        rows.append(kinds)
    return rows


def _merged(kinds: list[list[str]], size: float) -> list[str]:
    """Neighbours of one class in a row as one rectangle, all rectangles of a class as one path."""
    paths: dict[str, list[str]] = {}
    for i, row in enumerate(kinds):
        j = 0
        while j < len(row):
            end = j
            while end < len(row) and row[end] == row[j]:
                end += 1
            if row[j]:
                paths.setdefault(row[j], []).append(_cell(i, j, end - j, size))
            j = end
    return [element("path", d="".join(paths[kind]), class_=f"cell {kind}") for kind in sorted(paths)]


def _titled(
    kinds: list[list[str]], matrix: NDArray[np.float64], size: float, of: str, names: Sequence[int]
) -> list[str]:
    """Every cell by itself, with its value for a pointer."""
    cells = []
    for i, row in enumerate(kinds):
        for j, kind in enumerate(row):
            if kind:
                value = float(matrix[i, j])
                said = f"{distance(value)} cm" if np.isfinite(value) else "not finite"
                path = _cell(i, j, 1, size)
                cells.append(
                    element("path", title(f"{of} {names[i]}, {of} {names[j]}: {said}"), d=path, class_=f"cell {kind}")
                )
    return cells


def _cell(i: int, j: int, columns: int, size: float) -> str:
    x, y, w = number(_LEFT + j * size), number(_TOP + i * size), number(columns * size)
    return f"M{x} {y}h{w}v{number(size)}h-{w}z"


def _bar(scale: Scale | None, side: float) -> list[str]:
    """The scale, and the swatch of exact zeros below it."""
    x, width, height = _LEFT + side + 16, 12.0, side - 34
    drawn = []
    if scale:
        step = height / LEVELS
        drawn += [
            element("rect", x=x, y=_TOP + height - (i + 1) * step, width=width, height=step + 0.3, class_=f"q{i} flat")
            for i in range(LEVELS)
        ]
        drawn += [plot.right(x + width, _TOP + (1 - share) * height, label) for share, label in _labels(scale, height)]
    swatch = _TOP + side - 12
    drawn.append(element("rect", x=x, y=swatch, width=width, height=12, class_="zero"))
    drawn.append(text("exactly 0", x + width + 7, swatch + 10, class_="small"))
    return drawn


def _labels(scale: Scale, height: float) -> list[tuple[float, str]]:
    """Both ends of the scale, and round values between them as far as there is room."""
    ends = {1.0: f"{_rounded(scale.high)} cm"} | ({0.0: _rounded(scale.low)} if scale.low < scale.high else {})
    ticks = plot.log_ticks(scale.low, scale.high) if scale.low < scale.high else []
    marks = [(scale.share(value), _rounded(value)) for value in ticks]
    between = [mark for mark in marks if all(abs(mark[0] - end) * height >= _CLOSE for end in ends)]
    return [*ends.items(), *between]


def _rounded(value: float) -> str:
    return f"{value:.3g}" if value >= 0.001 else f"{value:.0e}"
