"""Every figure of the report as files for a paper: SVG, PDF and the numbers that it draws.

A PDF has vectors, text as text, and its font inside. The figures of this project are made of few kinds of elements, and
`style.standalone` writes their looks into them, so that they are drawn here one by one; what is not known is an error
and not left out. The font is Bitstream Vera, which comes with reportlab, set somewhat narrower: the figures are laid
out for fonts of that width.
"""

from __future__ import annotations

import io
import itertools
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

from gpusimbench.evaluator.render import table_files
from gpusimbench.evaluator.render.document import Figure
from gpusimbench.evaluator.render.figures import palette
from gpusimbench.evaluator.render.figures.matrix import hatch
from gpusimbench.evaluator.render.figures.style import standalone
from gpusimbench.evaluator.render.table_files import to_csv
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation
from gpusimbench.schemas.errors import UsageError
from gpusimbench.schemas.text import printable
from gpusimbench.schemas.writing import write_files

_POINTS_PER_PIXEL = 0.75
_FONT, _FONT_FILE = "Vera", "Vera.ttf"
_NARROW, _SMALLER = 88, 0.94  # per cent of its width; of its size
_SEAM = 0.3  # areas that touch would show a line of paper between them
_RAISED = str.maketrans("\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079\u207a\u207b", "0123456789+\u2212")
_LOWERED = str.maketrans("\u2080\u2081\u2082\u2083\u2084\u2085\u2086\u2087\u2088\u2089", "0123456789")
_SPACES = str.maketrans("\u2009\u202f\u00a0", "   ")

Attributes = Mapping[str, str]

INDEX = "figures.tex"

HEAD = """\
% Figures of an evaluation by gpusimbench; needs \\usepackage{graphicx}, pdfLaTeX or a newer engine.
% Each file lies beside this one; its SVG and the numbers that it draws have the same name.
"""


def reportlab() -> Any:
    """The package that writes PDF, its canvas; UsageError where it is not installed."""
    try:
        return import_module("reportlab.pdfgen.canvas")
    except ImportError:
        raise UsageError("--figures needs the package reportlab: pip install 'gpusimbench[figures]'") from None


def to_pdf(svg: str, title: str) -> bytes:
    """A figure of one page; the same figure gives the same bytes.

    svg  a figure that stands alone, 1 px of it is 0.75 pt

    Raises:
        ValueError: it holds what no figure here is made of.
        UsageError: reportlab is not installed.
    """
    root = ET.fromstring(svg.encode())
    width, height = float(root.attrib["width"]), float(root.attrib["height"])
    written = io.BytesIO()
    size = (width * _POINTS_PER_PIXEL, height * _POINTS_PER_PIXEL)
    drawing = reportlab()
    _with_font()
    canvas = drawing.Canvas(written, pagesize=size, invariant=1, pageCompression=1, initialFontName=_FONT)
    canvas.setTitle(title)
    canvas.setCreator("gpusimbench")
    canvas.scale(_POINTS_PER_PIXEL, -_POINTS_PER_PIXEL)
    canvas.translate(0, -height)  # y goes down from here on, as in the figure
    _children(canvas, root)
    canvas.showPage()
    canvas.save()
    return written.getvalue()


def _with_font() -> None:
    fonts, true_type = import_module("reportlab.pdfbase.pdfmetrics"), import_module("reportlab.pdfbase.ttfonts")
    if _FONT not in fonts.getRegisteredFontNames():
        fonts.registerFont(true_type.TTFont(_FONT, _FONT_FILE))


def _children(canvas: Any, parent: ET.Element) -> None:
    for one in parent:
        kind = one.tag.rpartition("}")[2]
        if kind == "g":
            if set(one.attrib) - {"class"}:
                raise ValueError(f"a group of a figure with {', '.join(sorted(one.attrib))} cannot be drawn as PDF")
            _children(canvas, one)
        elif kind == "text":
            _text(canvas, one)
        elif kind not in ("title", "desc", "defs") and one.get("class") != "page":  # the ground is the paper's
            _shape(canvas, _outline(kind, one.attrib), one.attrib)


def _outline(kind: str, at: Attributes) -> list[tuple[str, tuple[float, ...]]]:
    """Any shape as absolute moves, lines, curves and closings."""

    def get(name: str) -> float:
        return float(at.get(name, "0"))

    match kind:
        case "rect":
            x, y, w, h = get("x"), get("y"), get("width"), get("height")
            return [("M", (x, y)), ("L", (x + w, y)), ("L", (x + w, y + h)), ("L", (x, y + h)), ("Z", ())]
        case "line":
            return [("M", (get("x1"), get("y1"))), ("L", (get("x2"), get("y2")))]
        case "circle":
            return list(_circle(get("cx"), get("cy"), get("r")))
        case "path":
            return list(_path(at["d"]))
    raise ValueError(f"<{kind}> of a figure cannot be drawn as PDF")


def _circle(x: float, y: float, r: float) -> Iterator[tuple[str, tuple[float, ...]]]:
    k = 0.5522847498 * r  # four Bezier curves, off by 0.03 % of the radius at most
    yield "M", (x + r, y)
    yield "C", (x + r, y + k, x + k, y + r, x, y + r)
    yield "C", (x - k, y + r, x - r, y + k, x - r, y)
    yield "C", (x - r, y - k, x - k, y - r, x, y - r)
    yield "C", (x + k, y - r, x + r, y - k, x + r, y)
    yield "Z", ()


def _path(data: str) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Path data as absolute commands; of M, L, H, V, C and Z in either case."""
    x = y = begin_x = begin_y = 0.0
    for command, numbers in re.findall(r"([A-Za-z])([^A-Za-z]*)", data):
        kind, relative = command.upper(), command.islower()
        taken = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "Z": 0}.get(kind)
        if taken is None:
            raise ValueError(f"the path command {command} of a figure cannot be drawn as PDF")
        values = [float(v) for v in re.findall(r"-?(?:\d+\.?\d*|\.\d+)(?:e-?\d+)?", numbers)]
        if kind == "Z":
            x, y = begin_x, begin_y
            yield "Z", ()
            continue
        for group in _grouped(values, taken):
            dx, dy = (x, y) if relative else (0.0, 0.0)
            if kind == "H":
                group = (group[0] + dx, y)
            elif kind == "V":
                group = (x, group[0] + dy)
            else:
                group = tuple(v + (dy if i % 2 else dx) for i, v in enumerate(group))
            x, y = group[-2:]
            if kind == "M":
                begin_x, begin_y = x, y
            yield ("C" if kind == "C" else "M" if kind == "M" else "L"), group
            kind = "L" if kind == "M" else kind  # what follows the first point of a move are lines


def _grouped(values: list[float], size: int) -> Iterator[tuple[float, ...]]:
    for begin in range(0, len(values) - size + 1, size):
        yield tuple(values[begin : begin + size])


def _shape(canvas: Any, outline: list[tuple[str, tuple[float, ...]]], at: Attributes) -> None:
    path = canvas.beginPath()
    draw = {"M": path.moveTo, "L": path.lineTo, "C": path.curveTo, "Z": path.close}
    for command, numbers in outline:
        draw[command](*numbers)
    canvas.saveState()
    fill, stroke = at.get("fill", "#000000"), at.get("stroke", "none")
    if fill.startswith("url("):
        _hatched(canvas, path, outline)
        fill = "none"
    width = float(at.get("stroke-width", "1"))
    if stroke == "none" and fill != "none" and at.get("shape-rendering") == "crispEdges":
        stroke, width = fill, _SEAM
    if fill != "none":
        canvas.setFillColor(_colour(fill), alpha=float(at.get("fill-opacity", "1")))
    if stroke != "none":
        _pen(canvas, stroke, width, at)
    if fill != "none" or stroke != "none":
        canvas.drawPath(path, fill=int(fill != "none"), stroke=int(stroke != "none"))
    canvas.restoreState()


def _hatched(canvas: Any, path: Any, outline: list[tuple[str, tuple[float, ...]]]) -> None:
    """Fill with the pattern of exact zeros: a ground and lines that rise, 6 px apart as in the page's pattern."""
    theme = palette.theme(dark=False)
    xs = [v for _, numbers in outline for v in numbers[::2]]
    ys = [v for _, numbers in outline for v in numbers[1::2]]
    canvas.saveState()
    canvas.clipPath(path, stroke=0, fill=0)
    canvas.setFillColor(_colour(theme["zero"]))
    canvas.rect(min(xs), min(ys), max(xs) - min(xs), max(ys) - min(ys), fill=1, stroke=0)
    canvas.setStrokeColor(_colour(theme["zero-line"]))
    canvas.setLineWidth(0.8)
    for total in range(int((min(xs) + min(ys)) // 6) * 6, int(max(xs) + max(ys)) + 6, 6):
        canvas.line(total - max(ys), max(ys), total - min(ys), min(ys))  # x + y is the same along it
    canvas.restoreState()


def _pen(canvas: Any, stroke: str, width: float, at: Attributes) -> None:
    canvas.setStrokeColor(_colour(stroke), alpha=float(at.get("stroke-opacity", "1")))
    canvas.setLineWidth(width)
    if at.get("stroke-linejoin") == "round":
        canvas.setLineJoin(1)
    if at.get("stroke-dasharray", "none") != "none":
        canvas.setDash([float(v) for v in re.split(r"[ ,]+", at["stroke-dasharray"].strip())])


def _text(canvas: Any, one: ET.Element) -> None:
    at = one.attrib
    runs = list(_runs("".join(one.itertext())))
    size = float(at["font-size"]) * _SMALLER
    metrics = import_module("reportlab.pdfbase.pdfmetrics")
    long = sum(metrics.stringWidth(run, _FONT, size * scale) for run, scale, _ in runs) * _NARROW / 100
    shift = {"middle": -long / 2, "end": -long}.get(at.get("text-anchor", "start"), 0.0)
    canvas.saveState()
    canvas.translate(float(at["x"]), float(at["y"]))
    canvas.rotate(_turned(at))
    canvas.scale(1, -1)  # letters stand upright again
    if "stroke" in at and at.get("paint-order") == "stroke":
        canvas.saveState()
        _pen(canvas, at["stroke"], float(at.get("stroke-width", "1")), at)
        _line(canvas, runs, shift, size, mode=1)
        canvas.restoreState()
    canvas.setFillColor(_colour(at["fill"]))
    _line(canvas, runs, shift, size, mode=0)
    canvas.restoreState()


def _line(canvas: Any, runs: list[tuple[str, float, float]], x: float, size: float, *, mode: int) -> None:
    drawn = canvas.beginText(x, 0)
    drawn.setTextRenderMode(mode)
    drawn.setHorizScale(_NARROW)
    for run, scale, rise in runs:
        drawn.setFont(_FONT, size * scale)
        drawn.setRise(rise * size)
        drawn.textOut(run)
    canvas.drawText(drawn)


def _runs(text: str) -> Iterator[tuple[str, float, float]]:
    """Text as (letters that the font has, size, rise): raised and lowered digits are small ones."""

    def place(letter: str) -> int:
        return 1 if ord(letter) in _RAISED else -1 if ord(letter) in _LOWERED else 0

    known = import_module("reportlab.pdfbase.pdfmetrics").getFont(_FONT).face.charToGlyph
    for where, letters in itertools.groupby(text.translate(_SPACES), place):
        plain = "".join(letters).translate(_RAISED).translate(_LOWERED)
        shown = "".join(c if ord(c) in known else "?" for c in plain)
        yield shown, 0.7 if where else 1.0, {1: 0.38, -1: -0.15}.get(where, 0.0)


def _turned(at: Attributes) -> float:
    """Degrees of rotation about the text's own place, which is all that figures use."""
    if "transform" not in at:
        return 0.0
    found = re.fullmatch(r"rotate\((\S+) (\S+) (\S+)\)", at["transform"])
    if found is None or (found[2], found[3]) != (at["x"], at["y"]):
        raise ValueError(f"the transform {at['transform']} of a figure cannot be drawn as PDF")
    return float(found[1])


def _colour(name: str) -> Any:
    return import_module("reportlab.lib.colors").HexColor(name)


def write_figures(evaluation: Evaluation, folder: Path, *, published: bool) -> list[Path]:
    """Write all figures that have something to show; returns the files' paths, `figures.tex` last.

    NAME.svg, NAME.pdf  light theme; a white ground in the SVG, none in the PDF
    NAME.csv            what it draws, where it says so
    figures.tex         a figure environment for each, to be taken apart

    Raises:
        UsageError: reportlab is not installed.
        GsbError: a file cannot be written; those of an earlier time are as they were.
    """
    files: dict[Path, bytes | str] = {}
    environments = [HEAD]
    drawn = report(Source(evaluation, published, "")).figures()
    for name, picture in named(one for one in drawn if one.svg and one.key):
        svg = standalone(str(picture.svg), hatch())
        files[folder / f"{name}.svg"] = svg
        files[folder / f"{name}.pdf"] = to_pdf(svg, printable(picture.title))
        if picture.numbers.titles:
            files[folder / f"{name}.csv"] = to_csv(picture.numbers.titles, picture.numbers.rows)
        said = ". ".join(part.removesuffix(".") for part in (picture.title, picture.caption, picture.reading) if part)
        environments.append(table_files.figure(name, f"{said}."))
    files[folder / INDEX] = "\n".join(environments)
    write_files(files)
    return list(files)


def named(pictures: Iterable[Figure]) -> Iterator[tuple[str, Figure]]:
    """Pictures with the names of their files, no name twice."""
    taken: set[str] = set()
    for picture in pictures:
        name, number = picture.file_name, 1
        while name in taken:
            number += 1
            name = f"{picture.file_name}-{number}"
        taken.add(name)
        yield name, picture
