"""SVG as text: elements, numbers and paths; whatever comes from a recording is escaped here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from xml.sax.saxutils import escape, quoteattr

from gpusimbench.schemas.text import printable


def number(value: float) -> str:
    """A coordinate in at most two decimals.

    Raises:
        ValueError: the value is not finite; a figure decides what to do with it, not the file format.
    """
    if not math.isfinite(value):
        raise ValueError(f"a coordinate must be finite: {value}")
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def element(name: str, *children: str, **attributes: str | float | None) -> str:
    """An element of SVG children.

    children    SVG already
    attributes  by name; `class_` is "class", other underscores are hyphens; None is left out
    """
    written = []
    for key, value in attributes.items():
        if value is not None:
            plain = printable(value) if isinstance(value, str) else number(value)
            written.append(f" {key.rstrip('_').replace('_', '-')}={quoteattr(plain)}")
    opening = f"<{name}{''.join(written)}"
    return f"{opening}>{''.join(children)}</{name}>" if children else f"{opening}/>"


def text(content: str, x: float, y: float, *, class_: str = "", rotate: float = 0.0) -> str:
    """A line of text at (x, y) in figure units, turned by `rotate` degrees around that point."""
    turned = f"rotate({number(rotate)} {number(x)} {number(y)})" if rotate else None
    return element("text", escape(printable(content)), x=x, y=y, class_=class_ or None, transform=turned)


def title(content: str) -> str:
    """What a pointer resting on the parent element shows."""
    return element("title", escape(printable(content)))


def figure(width: float, height: float, label: str, *children: str) -> str:
    """The outermost element: a picture with a label for those who cannot see it."""
    box = f"0 0 {number(width)} {number(height)}"
    style = f"--units:{number(width)};max-width:{width / 14:.1f}rem"
    return element("svg", *children, viewBox=box, role="img", aria_label=label, style=style)


def open_path(points: Iterable[Sequence[float] | None]) -> str:
    """Path data of straight lines from point to point (x, y), with a gap at each None."""
    data, pen = "", "M"
    for point in points:
        if point is not None:
            data += f"{pen}{number(point[0])} {number(point[1])}"
        pen = "M" if point is None else "L"
    return data


def closed_path(points: Iterable[Sequence[float]]) -> str:
    """Path data of a polygon through the points (x, y)."""
    return f"{open_path(points)}Z"


def whisker_across(y: float, low: float, high: float, cap: float = 3.0) -> str:
    """Path data of a horizontal line from `low` to `high`; caps at both ends reach `cap` up and down."""
    caps = "".join(f"M{number(end)} {number(y - cap)}v{number(2 * cap)}" for end in (low, high))
    return f"M{number(low)} {number(y)}H{number(high)}{caps}"


def whisker_up(x: float, low: float, high: float, cap: float = 3.0) -> str:
    """Path data of a vertical line from `low` to `high`; caps at both ends reach `cap` to the left and right."""
    caps = "".join(f"M{number(x - cap)} {number(end)}h{number(2 * cap)}" for end in (low, high))
    return f"M{number(x)} {number(low)}V{number(high)}{caps}"
