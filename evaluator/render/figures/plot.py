"""What figures share: round tick values, a frame with its labels, and lines of several series, by colour, dash and
mark."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from gpusimbench.evaluator.render.figures.palette import GROUPS_LIGHT
from gpusimbench.evaluator.render.figures.svg import closed_path, element, number, text

_DASHES = ("", "7 3", "2 3", "9 3 2 3")
_MARKS = 4
_ROW, _SWATCH, _LETTER = 16.0, 40.0, 6.2


def ticks(low: float, high: float, *, at_most: int = 7) -> list[float]:
    """Round values from low to high: multiples of 1, 2 or 5 times a power of ten, at most so many."""
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise ValueError(f"an axis goes from a smaller to a larger finite value, not from {low} to {high}")
    rough = (high - low) / at_most
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(step for factor in (1, 2, 5, 10, 20) if (high - low) / (step := factor * power) < at_most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [round(i * step, 12) for i in range(first, last + 1)]


def log_ticks(low: float, high: float, *, at_most: int = 7) -> list[float]:
    """Round values from low to high for a logarithmic axis: powers of ten, with 2 and 5 between them where few fit.

    An axis too short for two of these has evenly spaced values.
    """
    if not (math.isfinite(high) and 0 < low < high):
        raise ValueError(f"a logarithmic axis goes from a smaller to a larger positive value, not from {low} to {high}")
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for factors in ((1, 2, 5), (1,)):
        found = [
            f * 10.0**e for e in exponents for f in factors if low * (1 - 1e-9) <= f * 10.0**e <= high * (1 + 1e-9)
        ]
        if len(found) <= at_most:
            return found if len(found) > 1 else ticks(low, high, at_most=min(at_most, 5))
    return found[:: -(-len(found) // at_most)]


def power_ticks(low: float, high: float, *, at_most: int = 8) -> list[int]:
    """Powers of two from low to high, evenly spaced, at most so many."""
    exponents = list(range(math.ceil(math.log2(low) - 1e-9), math.floor(math.log2(high) + 1e-9) + 1))
    return [2**e for e in exponents[:: max(1, -(-len(exponents) // at_most))]]


def index_ticks(count: int) -> list[int]:
    """Indices from 0 to count - 1 at a round distance."""
    if count < 3:
        return list(range(count))
    distance = max(1, round(ticks(0, count, at_most=8)[1]))
    return list(range(0, count, distance))


def bottom(x: float, y: float, label: str) -> str:
    """A tick and its label below a frame."""
    line = element("line", x1=x, x2=x, y1=y, y2=y + 4, class_="axis")
    return line + text(label, x, y + 15, class_="mid")


def left(x: float, y: float, label: str) -> str:
    """A tick and its label left of a frame."""
    line = element("line", x1=x - 4, x2=x, y1=y, y2=y, class_="axis")
    return line + text(label, x - 7, y + 4, class_="end")


def right(x: float, y: float, label: str) -> str:
    """A tick and its label right of a frame."""
    line = element("line", x1=x, x2=x + 4, y1=y, y2=y, class_="axis")
    return line + text(label, x + 7, y + 4)


def frame(x: float, y: float, width: float, height: float) -> str:
    """The outline of the area that data is drawn in."""
    return element("rect", x=x, y=y, width=width, height=height, class_="frame")


def tick_label(value: float) -> str:
    """A tick's value without needless digits, with a true minus sign."""
    return (f"{value:g}" if abs(value) < 1e4 else number(value)).replace("-", "\u2212")


def mark(index: int, x: float, y: float, *, hollow: bool = False) -> str:
    """The mark of a series at a point, filled with its colour or with the page's."""
    class_ = f"{colour_class(index)} nothing" if hollow else colour_class(index)
    shapes = {
        0: element("circle", cx=x, cy=y, r=3.6, class_=class_),
        1: element("rect", x=x - 3.2, y=y - 3.2, width=6.4, height=6.4, class_=class_),
        2: element("path", d=closed_path([(x, y - 4.6), (x + 4.2, y + 3), (x - 4.2, y + 3)]), class_=class_),
        3: element("path", d=closed_path([(x, y - 4.6), (x + 4.6, y), (x, y + 4.6), (x - 4.6, y)]), class_=class_),
    }
    return shapes[_style(index) % _MARKS]


def path(index: int, data: str) -> str:
    """A series's line, along path data."""
    return element("path", d=data, class_=line_class(index), stroke_dasharray=dash(index))


def legend(
    labels: Sequence[tuple[int, str]],
    x: float,
    y: float,
    width: float,
    *,
    marks_alone: Collection[int] = (),
    lines_alone: Collection[int] = (),
) -> tuple[str, float]:
    """Names of series below a figure, and the height that they take; a name without room loses its middle.

    labels       index and name of each
    marks_alone  indices of those that have no line in the figure
    lines_alone  indices of those that have no marks in the figure
    """
    columns = 2 if all(len(label) * _LETTER < width / 2 - _SWATCH for _, label in labels) else 1
    room = int((width / columns - _SWATCH) / _LETTER)
    drawn = []
    for i, (index, label) in enumerate(labels):
        left, middle = x + (i % columns) * width / columns, y + _ROW * (i // columns) + _ROW / 2
        shown = label if len(label) <= room else f"{label[: room // 2]}\u2026{label[1 - room + room // 2 :]}"
        if index not in marks_alone:
            drawn.append(path(index, f"M{number(left)} {number(middle)}h32"))
        if index not in lines_alone:
            drawn.append(mark(index, left + 16, middle))
        drawn.append(text(shown, left + _SWATCH, middle + 3.7, class_="small"))
    return element("g", *drawn) if drawn else "", _ROW * -(-len(labels) // columns)


def colour_class(index: int) -> str:
    """Class of the series's colour."""
    return f"g{index % len(GROUPS_LIGHT)}"


def line_class(index: int) -> str:
    """Class of the series's line."""
    return f"{colour_class(index)} line"


def dash(index: int) -> str | None:
    """The series's dash pattern; None where its line is solid."""
    return _DASHES[_style(index) % len(_DASHES)] or None


def _style(index: int) -> int:
    """Which dash and mark; where colours begin again, these are shifted against them."""
    return index + index // len(GROUPS_LIGHT)
