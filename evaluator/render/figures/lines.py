"""Lines of several series in one figure: colour, dash and mark by index, so that none depends on colour alone."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from gpusimbench.evaluator.render.figures.palette import GROUPS_LIGHT
from gpusimbench.evaluator.render.figures.svg import closed_path, element, number, text

_DASHES = ("", "7 3", "2 3", "9 3 2 3")
_MARKS = 4
_ROW, _SWATCH, _LETTER = 16.0, 40.0, 6.2


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
