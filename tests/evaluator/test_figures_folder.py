"""Figures as files for a paper."""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import Markup

from gpusimbench.evaluator.cli.eval import main
from gpusimbench.evaluator.metrics.density import HexGrid
from gpusimbench.evaluator.render import table_files
from gpusimbench.evaluator.render.document import Figure, key_of
from gpusimbench.evaluator.render.figures import matrix, style, svg
from gpusimbench.evaluator.report.document import report
from gpusimbench.evaluator.report.paper import HEAD, INDEX, named, to_pdf, write_figures
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from tests.conftest import finished
from tests.synthetic import grid, write_recording, write_simulators, write_sweep

HOSTILE = r"\input{/etc/passwd} $x^2$ & 50 % #1 {_} ~ <script> \x00"


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Two simulators that captured states and two sweeps."""
    folder = tmp_path_factory.mktemp("figures")
    write_simulators(folder, "one", HOSTILE)
    write_sweep(folder, (1, 4, 16), simulator="two", scene="free-fall", allocator_peak=3 * 10**9)
    return evaluate_files(sorted(folder.glob("*.mcap")))


@pytest.fixture(scope="module")
def written(evaluation: Evaluation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of its figures."""
    pytest.importorskip("reportlab")
    folder = tmp_path_factory.mktemp("written") / "figures"
    paths = write_figures(evaluation, folder, published=True)
    assert sorted(paths) == sorted(folder.iterdir())
    return folder


def pdf_of(*children: str) -> bytes:
    """A figure with these elements as PDF."""
    pytest.importorskip("reportlab")
    return to_pdf(style.standalone(svg.figure(200, 100, "a", *children), matrix.hatch()), "a")


def drawn(pdf: bytes, folder: Path, *, scale: int = 4) -> np.ndarray:
    """A PDF's page as pixels, shape [row, column, 3]."""
    if shutil.which("pdftoppm") is None:
        pytest.skip("no pdftoppm to draw PDF with")
    path = folder / "a.pdf"
    path.write_bytes(pdf)
    done = subprocess.run(["pdftoppm", "-r", str(96 * scale), str(path)], capture_output=True, check=True)
    head, size, _, pixels = done.stdout.split(b"\n", 3)
    assert head == b"P6"
    width, height = map(int, size.split())
    return np.frombuffer(pixels, dtype=np.uint8).reshape(height, width, 3)


def words(pdf: bytes, folder: Path) -> str:
    """A PDF's text."""
    if shutil.which("pdftotext") is None:
        pytest.skip("no pdftotext to read PDF with")
    (folder / "a.pdf").write_bytes(pdf)
    done = finished(["pdftotext", "-layout", str(folder / "a.pdf"), "-"])
    return done.stdout


def test_every_figure_of_the_page_is_written(evaluation: Evaluation, written: Path) -> None:
    """Write each figure that the page offers to save as SVG, PDF and CSV."""
    shown = [p for p in report(Source(evaluation, True, "")).figures() if p.svg and p.key]
    assert len(shown) >= 8
    assert len(list(written.glob("*.svg"))) == len(list(written.glob("*.pdf"))) == len(shown)
    assert len(list(written.glob("*.csv"))) == sum(bool(p.numbers.titles) for p in shown)
    for path in written.glob("*.svg"):
        assert ET.fromstring(path.read_bytes()).tag == "{http://www.w3.org/2000/svg}svg"
    for path in written.glob("*.pdf"):
        content = path.read_bytes()
        assert content.startswith(b"%PDF-")
        assert b"/FontFile2" in content  # its letters are inside
        assert b"/Helvetica" not in content
    for path in written.iterdir():
        assert re.fullmatch(r"[a-z0-9-]+\.(svg|pdf|csv|tex)", path.name)


def test_numbers_of_maps(evaluation: Evaluation, written: Path) -> None:
    """Write every position of a map: hexagons and what lies off it, and the same again along each side."""
    (path,) = written.glob("density-0-?-*-one*.csv")
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    count = {what: sum(int(r["positions"]) for r in rows if r["what"] == what) for what in {r["what"] for r in rows}}
    assert count["hexagon"] + count["off the map"] == 2 * 3 * 27
    assert count["strip along x"] == count["strip along y"] == count["hexagon"]
    shared = evaluation.maps["inclined-collision"]
    hexagons = [
        (float(r["x of its middle [m]"]), float(r["y of its middle [m]"])) for r in rows if r["what"] == "hexagon"
    ]
    one = next(r.cloud for r in evaluation.results if r.label.startswith("one") and r.cloud)
    np.testing.assert_allclose(hexagons, one.density.centres, atol=1e-9)
    assert isinstance(shared.grid, HexGrid)


def test_numbers_of_sweeps(written: Path) -> None:
    """Write each point with its interval's place, the model's value there, and why there is none."""
    with (written / "scaling-0-free-fall-throughput.csv").open(newline="", encoding="utf-8") as file:
        rows = [r for r in csv.DictReader(file) if r["sweep"] == "one"]
    assert [r["environments"] for r in rows] == ["1", "4", "16"]
    assert rows[1]["what"] == "N_env^max"
    assert (rows[2]["throughput [env-steps/s]"], rows[2]["what"]) == ("", "failed (device memory)")
    assert float(rows[0]["throughput [env-steps/s]"]) > 0


def test_the_index_is_latex(written: Path) -> None:
    """Name every PDF once, with balanced braces, no command of a stranger, and labels that are file names."""
    text = (written / INDEX).read_text(encoding="utf-8")
    names = re.findall(r"\\includegraphics\[width=\\linewidth\]\{(.*)\}", text)
    assert sorted(names) == sorted(p.stem for p in written.glob("*.pdf"))
    assert re.findall(r"\\label\{fig:(.*)\}", text) == names
    assert text.count(r"\begin{figure}") == text.count(r"\end{figure}") == len(names)
    assert_balanced(text)
    assert set(re.findall(r"\\([a-zA-Z]+)", text.removeprefix(HEAD))) <= {
        "begin", "end", "centering", "includegraphics", "linewidth", "caption", "label", "textbackslash", "textless",
        "textgreater", "textasciitilde", "textquotesingle", "textquotedblright", "times", "pm", "textasciicircum",
        "dots", "dagger",
    }  # fmt: skip
    assert r"\input" not in text


def test_captions_stand_alone(written: Path) -> None:
    """Caption no two figures alike; name the scene of each, the runs of a sweep's marks, and what whiskers are."""
    text = (written / INDEX).read_text(encoding="utf-8")
    found = dict(zip(*(re.findall(p, text) for p in (r"\\label\{fig:(.*)\}", r"\\caption\{(.*)\}")), strict=True))
    assert len(set(found.values())) == len(found)
    for name, caption in found.items():
        assert any(scene in caption for scene in ("inclined-collision", "free-fall", "franka")), name
        assert caption.endswith("."), name
        assert (name.startswith("scaling")) == ("Each mark is the mean of" in caption) or name.startswith("published")
        assert ("Ring: N" in caption) == name.startswith(("scaling", "published")), name


def assert_balanced(text: str) -> None:
    """Braces of LaTeX close as they open, escaped ones aside, and every formula ends where it began."""
    depth = 0
    for brace in re.findall(r"(?<!\\)(?:\\\\)*([{}])", re.sub(r"\\[{}$]", "", text)):
        depth += 1 if brace == "{" else -1
        assert depth >= 0
    assert depth == 0
    assert re.sub(r"\\\$", "", text).count("$") % 2 == 0


@given(st.text())
def test_any_text_is_harmless_latex(text: str) -> None:
    """Escape whatever is special, show what has no letter, and stay in one paragraph."""
    found = table_files.escape(text)
    assert_balanced(found)
    assert "\n" not in found
    assert not re.search(r"(?<!\\)[#%&_]", found)
    assert all(c.isascii() or ord(c) <= 0x17F for c in found)
    assert set(re.findall(r"\\([a-zA-Z]+)", found)) <= {
        "textbackslash", "textasciicircum", "textasciitilde", "textless", "textgreater", "textbar", "textquotedblright",
        "textasciigrave", "textquotesingle", "pm", "times", "le", "ge", "mu", "circ", "to", "dots", "dagger",
        "cdot",
    }  # fmt: skip


def test_signs_are_signs() -> None:
    """Set plus-minus, the minus sign, thin spaces and superscripts as LaTeX has them."""
    assert table_files.escape("1\u2009±\u20092 × 10⁻³") == r"1\,$\pm$\,2 $\times$ 10$^{-}$$^{3}$"
    assert table_files.escape("genesis †, N·s") == r"genesis $\dagger$, N$\cdot$s"
    assert table_files.escape("\u4e2d \u2212") == "[U+4E2D] $-$"


def test_no_sign_needs_other_fonts() -> None:
    """Set straight quotes and letters by what LaTeX's default font encoding, OT1, has; others show as numbers."""
    assert table_files.escape('"a" éßşů') == r"\textquotedblright{}a\textquotedblright{} éßşů"
    assert table_files.escape("Þęđħ") == "[U+00DE][U+0119][U+0111][U+0127]"


def test_text_comes_out(tmp_path: Path) -> None:
    """Keep text as text: true minus signs, thin spaces, raised digits, letters of the font; others show as ?."""
    said = words(pdf_of(svg.text("x\u20091 \u22122.5 ± 10\u207b\u00b3 é \u4e2d", 10, 50)), tmp_path)
    assert said.split()[:5] == ["x", "1", "\u22122.5", "±", "10\u22123"]
    assert said.split()[5:] == ["é", "?"]


def test_shapes_are_drawn_where_they_are(tmp_path: Path) -> None:
    """Put y downwards, fill, stroke and dash as the figure says, and leave paper white elsewhere."""
    pixels = drawn(
        pdf_of(
            svg.element("rect", x=20, y=10, width=40, height=20, fill="#ff0000"),
            svg.element("circle", cx=150, cy=70, r=10, fill="#0000ff"),
            svg.element("path", d="M100 10h40v10h-40z", fill="#00ff00"),
            svg.element("line", x1=0, y1=90, x2=100, y2=90, stroke="#000000", stroke_width=2, stroke_dasharray="10 10"),
        ),
        tmp_path,
    )
    assert pixels.shape == (400, 800, 3)

    def at(x: float, y: float) -> tuple[int, ...]:
        return tuple(int(v) for v in pixels[int(y * 4), int(x * 4)])

    assert at(40, 20) == (255, 0, 0)
    assert at(150, 70) == at(156, 70) == (0, 0, 255)
    assert at(120, 15) == (0, 255, 0)
    assert at(5, 90) == at(25, 90) == (0, 0, 0)
    assert at(15.5, 93) == at(100, 50) == at(62, 20) == (255, 255, 255)


def test_exact_zeros_are_hatched(tmp_path: Path) -> None:
    """Draw the pattern within the cell: ground and lines, and nothing beside it."""
    pixels = drawn(pdf_of(svg.element("path", d="M50 20h60v60h-60z", class_="cell zero")), tmp_path)
    inside = {tuple(map(int, p)) for p in pixels[90:310, 210:430].reshape(-1, 3)}
    assert (0xE3, 0xE6, 0xEA) in inside
    assert min(sum(p) for p in inside) < 3 * 0xA0
    pixels = pixels.copy()
    pixels[78:322, 198:442] = 255
    assert (pixels == 255).all()


def test_anchored_and_turned_text(tmp_path: Path) -> None:
    """End text where it is anchored, and turn it about its place."""
    ink = drawn(pdf_of(svg.text("MMMM", 100, 50, class_="end")), tmp_path).min(axis=2) < 128
    columns = np.flatnonzero(ink.any(axis=0)) / 4
    assert 96 < columns.max() <= 100.5
    ink = drawn(pdf_of(svg.text("MMMM", 100, 50, class_="mid", rotate=-90)), tmp_path).min(axis=2) < 128
    rows, columns = np.flatnonzero(ink.any(axis=1)) / 4, np.flatnonzero(ink.any(axis=0)) / 4
    assert rows.mean() == pytest.approx(50, abs=2)
    assert columns.max() <= 100.5


def test_names_with_a_halo_are_read(tmp_path: Path) -> None:
    """Draw letters over their halo, not under it."""
    ink = drawn(pdf_of(svg.text("MMMM", 50, 50, class_="foreign-name")), tmp_path)
    assert (ink.min(axis=2) < 100).sum() > 200


@pytest.mark.parametrize(
    "element",
    ["<ellipse rx='1'/>", "<path d='M0 0A1 1 0 0 0 1 1'/>", "<g transform='scale(2)'/>",
     "<text x='1' y='1' transform='skewX(3)' class='mid'>a</text>"],
)  # fmt: skip
def test_what_is_not_known_is_an_error(element: str) -> None:
    """Refuse what would be missing from the file."""
    with pytest.raises(ValueError, match="cannot be drawn as PDF"):
        pdf_of(element)


def test_the_same_figure_gives_the_same_bytes() -> None:
    """Write no date and no chance."""
    assert pdf_of(svg.text("a", 1, 2)) == pdf_of(svg.text("a", 1, 2))


def test_names_of_files() -> None:
    """Make a file's name of any words, and no name twice."""
    assert key_of("density", 3, "../../etc/passwd") == "density-3-etc-passwd"
    assert key_of("\u4e2d\u6587") == "figure"
    assert len(key_of("x" * 1000)) == 80
    alike = [Figure("a", "", Markup("<svg/>"), key) for key in ("a b", "A/B", "a-b-2")]
    assert [name for name, _ in named(alike)] == ["a-b", "a-b-2", "a-b-2-2"]


def test_without_the_package(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Say what to install before any file is read."""
    monkeypatch.setitem(sys.modules, "reportlab.pdfgen.canvas", None)
    assert main([str(tmp_path / "missing.mcap"), "--figures", str(tmp_path / "out")]) == 2
    assert "pip install 'gpusimbench[figures]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_command_writes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Write into a new folder, and say where; one line where that cannot be."""
    pytest.importorskip("reportlab")
    path = write_recording(tmp_path, grid(2))
    assert main([str(path), "--figures", str(tmp_path / "out")]) == 0
    written = len(list((tmp_path / "out").glob("*.svg")))
    assert written >= 2
    said = f"figures: {written} in {tmp_path / 'out'}, listed in {tmp_path / 'out' / INDEX}"
    assert said in capsys.readouterr().out
    (tmp_path / "file").write_text("")
    assert main([str(path), "--figures", str(tmp_path / "file" / "out")]) == 1
    assert f"cannot write {tmp_path / 'file' / 'out'}/" in capsys.readouterr().err
