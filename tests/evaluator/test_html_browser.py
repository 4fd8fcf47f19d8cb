"""The HTML report in a real browser: what a reader sees, reaches by keyboard, saves and prints."""

from __future__ import annotations

import csv
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from gpusimbench.evaluator.render.document import Figure
from gpusimbench.evaluator.render.figures import matrix, palette, style
from gpusimbench.evaluator.render.table_files import to_csv
from gpusimbench.evaluator.report.document import report, write_html
from gpusimbench.evaluator.report.source import Source
from gpusimbench.evaluator.results.evaluate import Evaluation, evaluate_files
from tests.browser import Browser, needs_chromium
from tests.conftest import finished
from tests.synthetic import grid, write_recording, write_simulators, write_sweep

pytestmark = needs_chromium

HOSTILE = "'><script>document.title='taken'</script><b onclick=x>=cmd|' /C calc'!A0"
PAPER = 739
"""Width of a sheet between its margins, US letter as Chromium prints [CSS pixel]."""

FOCUSABLE = """[...document.querySelectorAll('a[href], button:not(:disabled), select, input, summary, [tabindex="0"]')]
    .filter(e => e.checkVisibility({contentVisibilityAuto: true}) && !e.closest('[hidden]'))"""

FOLDED = "document.querySelector('#provenance').closest('details')"


OPEN_ALL = "document.querySelector('button[name=open]').click()"


@pytest.fixture(scope="module")
def evaluation(tmp_path_factory: pytest.TempPathFactory) -> Evaluation:
    """Simulators with states, one of a hostile name; two sweeps; a file that is none."""
    folder = tmp_path_factory.mktemp("recordings")
    write_simulators(folder, "one", "two", HOSTILE)
    write_recording(folder, grid(3), simulator="bad", status="INVALID", reason=HOSTILE, name="bad.mcap")
    write_sweep(folder, (1, 4, 16), simulator="two", scene="free-fall", allocator_peak=3 * 10**9)
    (folder / "no-recording.mcap").write_bytes(b"none")
    return evaluate_files(sorted(folder.glob("*.mcap")))


@pytest.fixture(scope="module")
def page(evaluation: Evaluation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its report, with everything that a report can have."""
    return write_html(evaluation, tmp_path_factory.mktemp("page"), published=True, command=f"gsb-eval {HOSTILE}")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [320, 768, 1280, 1920])
def test_the_page_fits(browser: Browser, page: Path, width: int, dark: bool) -> None:
    """Scroll tables and figures alone sideways, ask for nothing, and give the console no reason to complain."""
    browser.open(page, width=width, dark=dark)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    beyond = f"""[...document.querySelectorAll('body *')].filter(e => !e.closest('.table, .drawn, .skip')
        && e.getBoundingClientRect().right > {width} + 0.5).map(e => e.outerHTML.slice(0, 80))"""
    assert browser.evaluate(beyond) == []
    assert (browser.errors, browser.requests) == ([], [])
    assert browser.evaluate("document.title") == "Which simulator repeats itself, which is right, and how fast is each?"


@pytest.mark.parametrize("width", [320, 390, 760])
def test_figures_can_be_read_on_a_phone(browser: Browser, page: Path, width: int) -> None:
    """Draw no text of a figure smaller than 9 px: wide figures scroll, and the page does not."""
    browser.open(page, width=width)
    browser.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
    sizes = """[...document.querySelectorAll('figure svg')].flatMap(svg => [...svg.querySelectorAll('text')].map(
        one => parseFloat(getComputedStyle(one).fontSize)
               * svg.getBoundingClientRect().width / svg.viewBox.baseVal.width))"""
    found = browser.evaluate(sizes)
    assert len(found) > 50
    assert min(found) >= 9
    assert browser.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("width", [420, 1280])
def test_opened_rows_keep_their_notes(browser: Browser, tmp_path: Path, width: int) -> None:
    """Keep what an opened row says within its cells, and each table within the page, on a page of real recordings."""
    runs = sorted((Path(__file__).resolve().parents[2] / "recordings").glob("mujoco-*.mcap"))
    browser.open(write_html(evaluate_files(runs), tmp_path, published=False, command="gsb-eval"), width=width)
    browser.click("[name=open]")
    beyond = """[...document.querySelectorAll('.rows small')].filter(note => note.getClientRects().length
        && note.getBoundingClientRect().right > note.closest('td, th').getBoundingClientRect().right + 1)
        .map(note => note.textContent)"""
    assert browser.evaluate("document.querySelectorAll('details.row[open]').length") > 0
    assert browser.evaluate(beyond) == []
    wide = (
        "[...document.querySelectorAll('.table')].filter(t => t.scrollWidth > t.clientWidth + 1).map(t => t.ariaLabel)"
    )
    assert browser.evaluate(wide) == []


def test_the_page_can_be_read_at_four_hundred_per_cent(browser: Browser, page: Path) -> None:
    """Lay the page out anew where a reader zooms in (WCAG 1.4.10), with no text cut off."""
    browser.open(page, width=1280, zoom=4)
    assert browser.evaluate("document.documentElement.scrollWidth") <= 320
    cut = """[...document.querySelectorAll('p, li, h1, h2, h3, h4, dd, dt, summary, a, button, pre')]
        .filter(e => e.checkVisibility() && !e.closest('.table, .loud') && e.scrollWidth > e.clientWidth + 1
                     && getComputedStyle(e).display !== 'inline').map(e => e.outerHTML.slice(0, 80))"""
    assert browser.evaluate(cut) == []


def test_every_link_has_its_target(browser: Browser, page: Path) -> None:
    """Lead from every link to a place in the page, the first to the results."""
    browser.open(page)
    links = browser.evaluate("[...document.querySelectorAll('a')].map(a => a.getAttribute('href'))")
    assert links[0] == "#content"
    assert len(links) > 4
    assert browser.evaluate(f"{links!r}.filter(l => !document.querySelector('[id=\"' + l.slice(1) + '\"]'))") == []


def test_the_page_is_named_for_those_who_cannot_see_it(browser: Browser, page: Path) -> None:
    """Give headings in order without a gap, figures and regions a name, and every head of a table its scope."""
    browser.open(page)
    levels = browser.evaluate("[...document.querySelectorAll('h1,h2,h3,h4,h5')].map(h => +h.tagName[1])")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(below - above <= 1 for above, below in zip(levels, levels[1:], strict=False))
    assert browser.evaluate("document.documentElement.lang") == "en"
    unnamed = """[...document.querySelectorAll('svg:not([aria-hidden]), [role=region], nav, button')]
        .filter(e => !e.getAttribute('aria-label') && !(e.matches('button') && e.textContent.trim())).length"""
    assert browser.evaluate(unnamed) == 0
    assert browser.evaluate("[...document.querySelectorAll('svg:not([aria-hidden])')].every(e => e.role === 'img')")
    assert browser.evaluate("[...document.querySelectorAll('th')].every(e => e.scope || !e.textContent.trim())")


def test_tab_reaches_everything_in_order(browser: Browser, page: Path) -> None:
    """Go through all links, regions, buttons and folded parts in the order of the page, and out of it again."""
    browser.open(page)
    expected = browser.evaluate(f"window.all = {FOCUSABLE}; all.length")
    assert expected > 20
    reached = []
    for _ in range(expected):
        browser.key("Tab")
        reached.append(browser.evaluate("all.indexOf(document.activeElement)"))
    assert reached == list(range(expected))
    assert browser.evaluate("getComputedStyle(document.activeElement).outlineStyle") != "none"
    browser.key("Tab")
    assert browser.evaluate("all.indexOf(document.activeElement)") <= 0  # none is a trap


def test_keys_work(browser: Browser, page: Path) -> None:
    """Skip to the results, and unfold a part, without a mouse."""
    browser.open(page)
    browser.key("Tab")
    assert browser.evaluate("document.activeElement.getBoundingClientRect().left >= 0")
    browser.key("Enter")
    assert browser.evaluate("document.activeElement.id") == "content"
    browser.evaluate(f"{FOLDED}.querySelector('summary').focus()")
    browser.key("Enter")
    assert browser.evaluate(f"{FOLDED}.open")


def offered(evaluation: Evaluation) -> list[Figure]:
    """Figures that the page can save."""
    return [p for p in report(Source(evaluation, True, "")).figures() if p.svg and p.key]


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_figures_are_saved(browser: Browser, page: Path, evaluation: Evaluation, tmp_path: Path, dark: bool) -> None:
    """Save what Python writes: the same SVG whatever the theme, and the same numbers."""
    browser.open(page, dark=dark)
    browser.evaluate(OPEN_ALL)
    pictures = {p.file_name: p for p in offered(evaluation)}
    names = browser.evaluate("[...document.querySelectorAll('figure[data-file]')].map(f => f.dataset.file)")
    assert names == list(pictures)
    for name in (names[0], next(n for n in names if n.startswith("scaling")), names[-1]):
        for ending in ("svg", "csv"):
            button = f'figure[data-file="{name}"] button[value="{ending}"]'
            if not browser.evaluate(f"!!document.querySelector({button!r})"):
                assert not pictures[name].numbers.titles
                continue
            saved = browser.saved(button, tmp_path)
            assert saved.name == f"{name}.{ending}"
            content = saved.read_bytes()
            if ending == "csv":
                assert content.decode() == to_csv(pictures[name].numbers.titles, pictures[name].numbers.rows)
                rows = list(csv.reader(content.decode().splitlines()))
                assert len(rows) == 1 + len(pictures[name].numbers.rows)
                assert not any(cell.startswith(("=", "+", "@")) for row in rows for cell in row)
            else:
                wanted = style.standalone(str(pictures[name].svg), matrix.hatch())
                assert ET.canonicalize(content.decode()) == ET.canonicalize(wanted)
    assert browser.errors == []


def test_saved_figures_show_alone(browser: Browser, evaluation: Evaluation, tmp_path: Path) -> None:
    """Open a file by itself: no error, no request, and its text in the light theme's ink on white."""
    picture = next(p for p in offered(evaluation) if p.key.startswith("scaling"))
    path = tmp_path / "alone.svg"
    path.write_text(style.standalone(str(picture.svg), matrix.hatch()), encoding="utf-8")
    browser.open(path, dark=True)
    assert (browser.errors, browser.requests) == ([], [])
    red, green, blue = (int(palette.theme(dark=False)["ink"][i : i + 2], 16) for i in (1, 3, 5))
    assert browser.evaluate("getComputedStyle(document.querySelector('text')).fill") == f"rgb({red}, {green}, {blue})"


def test_other_scripts_are_refused(browser: Browser, page: Path, tmp_path: Path) -> None:
    """Run the page's own script alone: one letter more, a handler or another script is refused by the policy."""
    text = page.read_text(encoding="utf-8")
    spoilt = tmp_path / "index.html"
    bad = '<script>document.title = "taken"</script><img src="https://x.example/a" onerror="document.title = 1">'
    spoilt.write_text(text.replace("</body>", bad + "</body>").replace("// Saves", "// saves"), encoding="utf-8")
    browser.open(spoilt)
    assert browser.evaluate("document.title") == "Which simulator repeats itself, which is right, and how fast is each?"
    assert browser.evaluate("document.querySelector('.files').hidden")
    assert len(browser.errors) >= 3


def test_the_page_works_without_scripts(browser: Browser, page: Path) -> None:
    """Show everything but the buttons, which would do nothing."""
    browser.open(page, scripts=False)
    assert browser.evaluate("document.querySelectorAll('.files').length") > 8
    assert browser.evaluate("[...document.querySelectorAll('.files')].every(e => !e.checkVisibility())")
    assert browser.evaluate("[...document.querySelectorAll('main h2, main table, figure svg')].length") > 20
    browser.evaluate(f"{FOLDED}.querySelector('summary').focus()")
    browser.key("Enter")
    assert browser.evaluate(f"{FOLDED}.open")
    assert browser.errors == []


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_print_shows_what_is_open(browser: Browser, page: Path, dark: bool) -> None:
    """Cut no table off at the right, print headings of closed sections, omit buttons, print on white."""
    browser.open(page, width=PAPER, printed=True, dark=dark)
    cut: Any = browser.evaluate(
        f"""[...document.querySelectorAll('table, figure, pre, p')].filter(e => e.checkVisibility()
            && e.getBoundingClientRect().right > {PAPER} + 1).map(e => e.outerHTML.slice(0, 200))"""
    )
    assert cut == []
    hidden = "[...document.querySelectorAll('nav, .files, .skip')].every(e => !e.checkVisibility())"
    assert browser.evaluate(hidden)
    closed = "[...document.querySelectorAll('main > details')]"
    assert browser.evaluate(f"{closed}.length > 5")
    assert browser.evaluate(f"{closed}.every(e => e.querySelector('summary').checkVisibility() && !e.open)")
    assert browser.evaluate("getComputedStyle(document.documentElement).backgroundColor") == "rgb(255, 255, 255)"


def test_the_print_is_whole(browser: Browser, page: Path, tmp_path: Path) -> None:
    """Print every heading, and every recording's name where all sections are open."""
    if shutil.which("pdftotext") is None:
        pytest.skip("no pdftotext to read PDF with")
    browser.open(page)
    browser.evaluate(OPEN_ALL)
    browser.pdf(tmp_path / "page.pdf")
    done = finished(["pdftotext", str(tmp_path / "page.pdf"), "-"])
    browser.open(page)
    printed = "".join(done.stdout.split())
    for heading in browser.evaluate("[...document.querySelectorAll('h2')].map(h => h.textContent)"):
        assert "".join(heading.split()) in printed, heading
    for name in ("0-0.mcap", "bad.mcap", "no-recording.mcap"):
        assert name in printed


@pytest.mark.slow
def test_nothing_moves(browser: Browser, page: Path) -> None:
    """Animate nothing, for those who asked for less motion and for all others."""
    browser.open(page, still=True)
    moving = """[...document.querySelectorAll('*')].filter(e => { const s = getComputedStyle(e);
        return s.animationName !== 'none' || parseFloat(s.transitionDuration) > 0; }).length"""
    assert browser.evaluate(moving) == 0
