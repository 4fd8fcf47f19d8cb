"""Every renderer over one document: all that it says comes through, and no text of a stranger does anything there."""

from __future__ import annotations

import csv
import html
import html.parser
import io
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from markupsafe import Markup

from gpusimbench.evaluator.render.console import Screen, pieces
from gpusimbench.evaluator.render.document import (
    Beside,
    Cell,
    Code,
    Column,
    Document,
    Embed,
    Figure,
    Gallery,
    Item,
    Items,
    Numbers,
    Row,
    Section,
    Text,
    Tone,
    facts,
    items,
    key_of,
    table,
    walk,
)
from gpusimbench.evaluator.render.formats import Format
from gpusimbench.evaluator.render.html import render_page
from gpusimbench.evaluator.render.markdown import prose, render_markdown
from gpusimbench.evaluator.render.table_files import as_csv, as_latex, table_files
from gpusimbench.evaluator.render.terminal import print_blocks, print_document
from gpusimbench.schemas.text import line
from tests.browser import Browser, needs_chromium

HOSTILE = (
    "<script>document.title = 'gone'</script>",
    "</style></pre></title><img src=x onerror=alert(1)>",
    '" onmouseover="alert(1)" x=\'',
    "\x1b[2J\x1b[31mred\x07\r\nnext line\u2028other line",
    "a | b || c\n\n# heading\n- item",
    "::error file=a::b\n##[error]c",
    "@somebody GH-12 #1 https://example.org/ www.example.org [x](y) `code` **bold** <b>",
    "\\input{/etc/passwd} $x$ & % _ ^ ~ {",
    '=HYPERLINK("http://example.org")',
    "\u202egnp.exe\u200b\ufeff",
    "</tr></table></section></main>{{ 7 * 7 }}{% raw %}",
)


def document_of(text: str) -> Document:
    """A document in which every text of every block is `text`, behind a word that tells where it stands."""

    def of(where: str) -> str:
        return f"{where} {text}"

    one = Cell(
        of("cell"),
        3.5,
        (3.0, 4.0),
        of("range"),
        (of("note"),),
        Tone.BAD,
    )
    return Document(
        of("title"),
        (
            table(
                "of-values",
                of("caption"),
                [Column(of("head"), of("meaning")), of("column"), "code"],
                [
                    Row((Cell(of("row")), one, Cell(of("typed"), code=True, link="part")), {"simulator": of("facet")}),
                    Row((Cell(of("other row")), Cell("-", notes=(of("reason"),)), Cell("c")), {"simulator": "b"}),
                ],
                [of("legend")],
            ),
            Section(
                "part",
                of("section"),
                (
                    Text(of("paragraph"), Tone.WARNING),
                    facts((of("name"), of("fact"))),
                    Code((of("command"),)),
                    Items((Item(of("item"), Tone.GOOD, (Item(of("item within"), link="part"),)),)),
                    Beside(((Text(of("left")),), (items(of("right")),))),
                    Gallery((Figure(of("label"), of("why nothing is drawn"), None),)),
                    Embed(Markup("<p>a player</p>"), Markup(""), Markup(""), of("instead of the player")),
                ),
                of("summary"),
                folded=True,
                facets={"scene": of("of a scene")},
            ),
        ),
        of("lead"),
        (Text(of("made by")),),
    )


WHERE = [
    "title", "caption", "head", "column", "row", "cell", "range", "note", "typed", "reason", "legend", "section",
    "paragraph", "name", "fact", "command", "item", "item within", "left", "right", "label", "why nothing is drawn",
    "summary", "lead", "made by",
]  # fmt: skip


def printed(document: Document) -> str:
    stream = io.StringIO()
    print_document(document, stream)
    return stream.getvalue()


def test_everything_is_said_in_every_format_of_a_whole_document() -> None:
    document = document_of("X")
    for shown in (printed(document), render_markdown(document), render_page(document)):
        assert [where for where in WHERE if f"{where} X" not in shown] == []


@pytest.mark.parametrize("text", HOSTILE)
def test_a_terminal_prints_a_text_as_text(text: str) -> None:
    shown = printed(document_of(text))
    assert all(c == "\n" or c.isprintable() for c in shown)
    assert not re.search(r"^\s*(::error|##\[error)", shown, re.MULTILINE)
    # no line begins as one of ours: what a text's line goes on with has blanks before it
    ours = {one.split(" ")[0] for one in (*WHERE, "other row", "code", "instead")}
    assert {one.split(" ")[0] for one in shown.splitlines() if one and not one.startswith(" ")} <= ours


class _Elements(html.parser.HTMLParser):
    """Names and attributes of all elements, and whether they are closed in order."""

    _VOID = frozenset(("meta", "input", "br", "img", "link", "option"))

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, frozenset[str]]] = []
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, frozenset(name for name, _ in attrs)))
        if tag not in self._VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in self._VOID:
            assert self.open.pop() == tag


@given(st.one_of(st.sampled_from(HOSTILE), st.text(max_size=30)))
def test_a_page_has_the_same_elements_whatever_the_texts_are(text: str) -> None:
    plain, shown = _Elements(render_page(document_of("X"))), _Elements(render_page(document_of(text)))
    assert shown.found == plain.found
    assert shown.open == []


@given(st.one_of(st.sampled_from(HOSTILE), st.text(max_size=30)))
def test_markdown_has_the_same_structure_whatever_the_texts_are(text: str) -> None:
    markdown = MarkdownIt("commonmark", {"html": True}).enable("table")

    def structure(source: str) -> list[tuple[str, list[str]]]:
        kept = ("text", "softbreak")
        return [
            (token.type, [child.type for child in token.children or () if child.type not in kept])
            for token in markdown.parse(source)
        ]

    assert structure(render_markdown(document_of(text))) == structure(render_markdown(document_of("X")))


_MARKED = "ab1 .:;*_`~[](){}<>|!#&@\\/=+-^%$\n\t"
MARKUP = st.text(alphabet=st.one_of(st.sampled_from(_MARKED), st.characters()), min_size=1, max_size=30)
PIECES = st.lists(
    st.sampled_from([
        "*", "_", "__", "a", " ", "1.", "[x]", "[cm]", "(y)", ":", "&lt", "&amp;", "&#1", "<b", ">", "#", "|", "-", "~",
        "`", "![", "\\", "]:", "](",
    ]), min_size=1,
).map("".join)  # fmt: skip


def shown_by_markdown(source: str) -> list[str]:
    """What a reader of the rendered page sees, a text for each paragraph, heading, item, cell or element of HTML."""
    parser = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
    found = []
    for token in parser.parse(source):
        if token.type in ("inline", "html_block", "fence"):
            children = token.children or [token]
            allowed = {"text", "code_inline", "html_block", "fence"}
            assert {child.type for child in children} <= allowed, token
            texts = (child.content for child in children)
            found.append("".join(html.unescape(one) if token.type == "html_block" else one for one in texts))
    return [one.replace("\u200b", "").strip() for one in found]


@given(st.one_of(st.sampled_from(HOSTILE), MARKUP, PIECES).map(str.strip).filter(bool))
def test_what_markdown_shows_is_the_text_itself(text: str) -> None:
    said = line(re.sub(r"[\t\n\r]", " ", text))
    typed = line(text)
    document = Document(
        text,
        (
            Text(text),
            items(text),
            Items((Item("behind a word", items=(Item(f"in {text}"),)),)),
            facts((f"name {text}", Cell(f"fact {text}")), (text, Cell(text)), ("typed", Cell(f"a{text}b", code=True))),
            Section("part", text, (table("t", text, [text, "typed"], [(text, Cell(f"a{text}b", code=True))]),)),
            Section("folded", text, (), "and why", folded=True),
        ),
    )
    expected = [
        said, said, said, "behind a word", f"in {said}", f"name {said}: fact {said}", f"{said}: {said}",
        f"typed: a{typed}b", said, said, "typed", said, f"a{typed}b", f"Table: {said}",
        f"<details><summary>{said}: and why</summary>", "</details>",
    ]  # fmt: skip
    assert shown_by_markdown(render_markdown(document)) == expected


@pytest.mark.parametrize(
    "text",
    [
        "MuJoCo 3.3.7 (warp), dt 0.001 s: 12,345.6 +/- 7 env-steps/s, 95 % interval [3.1, 4.2] [cm]",
        "[3.1, 4.2] mujoco [cone=elliptic, mode=slow], state_array.py, deep/er/run_01-a.mcap & more",
        "a -> b, 2 < 3, C:/runs, R&D, #ok, 5-2, 1.5; 'x' = \"y\"!",
    ],
)
def test_markdown_leaves_ordinary_words_as_they_are(text: str) -> None:
    assert prose(text) == text


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a|b\nc", "a&#124;b c"),
        ("\x1b\u202e", "&#92;x1b&#92;u202e"),
        ("@team", "@\u200bteam"),
        ("see gh-12, and-3, #4", "see gh-\u200b12, and-3, #\u200b4"),
        ("https://example.org www.example.org", "https&#58;//example.org www\\.example.org"),
        ("__init__.py, snake_case", "\\_\\_init\\_\\_.py, snake_case"),
        ("1. first", "1\\. first"),
        ("2024. 1. 1.", "2024\\. 1. 1."),
        ("[x] [a](b) [c]: d", "\\[x] \\[a](b) \\[c]: d"),
        ("- item - else", "\\- item - else"),
    ],
)
def test_markdown_holds_off_what_would_be_markup(text: str, shown: str) -> None:
    assert prose(text) == shown


@given(st.lists(st.text(alphabet="`a\n~ ", max_size=12), min_size=1, max_size=4))
def test_code_in_markdown_is_one_block_whatever_its_lines_are(lines: list[str]) -> None:
    shown = render_markdown(Document("", (Code(tuple(lines)), Text("behind"))))
    tokens = MarkdownIt("commonmark").parse(shown)
    assert [token.type for token in tokens] == ["fence", "paragraph_open", "inline", "paragraph_close"]
    assert tokens[0].content.count("\n") == len(lines)


@given(st.one_of(st.sampled_from(HOSTILE), st.text(max_size=30)))
def test_csv_has_the_same_cells_and_no_formula(text: str) -> None:
    (found,) = document_of(text).tables()
    rows = list(csv.reader(io.StringIO(as_csv(found))))
    assert len(rows) == 3
    assert {len(row) for row in rows} == {6}  # two columns for the interval, one for remarks
    assert rows[1][1:4] == ["3.5", "3.0", "4.0"]
    assert not any(one.startswith(("=", "+", "@")) for row in rows for one in row)


@given(st.one_of(st.sampled_from(HOSTILE), st.text(max_size=30)))
def test_latex_has_no_command_of_a_stranger(text: str) -> None:
    def commands(source: str) -> list[str]:
        letters = re.findall(r"\\([a-zA-Z]+)", source)
        return [one for one in letters if not one.startswith("text") and one not in ("pm", "times", "le", "ge", "dots")]

    (plain,), (found,) = document_of("X").tables(), document_of(text).tables()
    assert commands(as_latex(plain)) == [
        one for one in commands(as_latex(found)) if one not in ("mu", "to", "circ", "dagger", "cdot")
    ]


def test_table_files_are_named_by_keys_and_none_is_lost() -> None:
    twice = Document("", (*document_of("a").blocks, *document_of("b").blocks))
    files = table_files(twice, [Format.CSV, Format.LATEX, Format.PARQUET])
    assert sorted(files) == ["of-values-2.csv", "of-values-2.tex", "of-values.csv", "of-values.tex"]
    assert b"cell b" in files["of-values-2.tex"]


def test_a_wide_table_stands_sideways_in_a_terminal_and_loses_nothing() -> None:
    rows = [[f"group {r}", *(Cell(f"{r}.{c} of many", float(c)) for c in range(30))] for r in range(7)]
    wide = Document("", (table("wide", "", ["group", *(f"metric {c}" for c in range(30))], rows),))
    shown = printed(wide)
    assert max(map(len, shown.splitlines())) <= 120
    for r in range(7):
        assert all(f"{r}.{c} of many" in shown for c in range(30))


def test_long_lines_of_a_fact_hang_below_its_first_word() -> None:
    """Wrap the first line of a fact and its further lines to the same column."""
    long = "word " * 60
    lines = printed(Document("", (facts(("runs", Cell(f"0: {long}", notes=(f"1: {long}",)))),))).splitlines()
    assert len(lines) >= 6
    assert {len(one) - len(one.lstrip()) for one in lines[1:]} == {len("  runs  ")}


def test_no_line_of_a_table_ends_in_blanks() -> None:
    """Print what can be pasted into a document, and nothing that breaks where a window is a little narrower."""
    long = table("t", "", ["a", "b"], [["1", "short"], ["2", "a text that is longer than the others"]])
    many = table("t", "", [*"abcdefgh"], [["x" * 30] * 8])
    shown = printed(Document("", (long, many)))
    assert "short" in shown
    assert all(one == one.rstrip() for one in shown.splitlines())


def test_the_first_line_is_as_wide_as_the_terminal_although_the_others_hang() -> None:
    """Fill the first line to the edge, and the others from their indentation on."""
    name, words = "n" * 30, "four " * 40
    first, *others = printed(Document("", (facts((name, words)),))).splitlines()
    assert len(first) > 115
    assert all(one.startswith(" " * 32) and len(one) > 115 for one in others[:-1])
    assert " ".join([first, *others]).split() == [name, *words.split()]


@pytest.mark.parametrize("length", [10, 47, 48, 90])
def test_a_long_name_takes_no_room_that_others_need(length: int) -> None:
    rows = [["n" * length, *(f"value-of-column-{c}" for c in range(5))], ["m", "1", "2", "3", "4", "5"]]
    shown = printed(Document("", (table("t", "", ["", *(f"column [{c}-unit-of-it]" for c in range(5))], rows),)))
    assert max(map(len, shown.splitlines())) <= 120
    for c in range(5):
        assert f"value-of-column-{c}" in shown
        assert f"[{c}-unit-of-it]" in shown


def test_a_long_word_takes_no_room_that_others_need() -> None:
    """Flags of XLA as notes of levels made columns two characters wide, and numbers three lines high."""
    flag = "--xla_gpu_exclude_nondeterministic_ops=true"
    levels = [Cell("1"), *[Cell("x 0.774", notes=(f"flags_of_level={flag}",))] * 3]
    rows = [[f"level {i}", *["4,096 x 3"] * 12, level] for i, level in enumerate(levels)]
    titles = ["group", *(f"environments {c}" for c in range(12)), "throughput"]
    shown = printed(Document("", (table("t", "", titles, rows),))).splitlines()
    assert max(map(len, shown)) <= 120
    assert any(all(f"level {i}" in row for i in range(4)) for row in shown)
    assert sum(row.count("4,096 x 3") for row in shown) == 4 * 12


NAMED = "newton [run-to-run, solver=mujoco, exclude-nondeterministic]"


@pytest.mark.parametrize("width", [60, 80, 100, 120])
def test_names_are_broken_behind_hyphens_alone(width: int) -> None:
    """Leave no part of a name in a line but one that ends at a blank or behind a hyphen or the like."""
    cells = ["16 x 3", "1 INVALID", "max_contact_points: 100%", "CONTACT_POINTS (DROPPED) at 3 recorded steps"]
    block = table("t", "", ["group", "envs x runs", "runs", "fullest buffer", "overflow"], [[NAMED, *cells]] * 3)
    stream = io.StringIO()
    print_blocks([block], Screen(file=stream, width=width, highlight=False, markup=False, emoji=False))
    shown = stream.getvalue()
    assert max(map(len, shown.splitlines())) <= width
    words = [word for text in (NAMED, *cells, "group envs x runs fullest buffer overflow") for word in text.split()]
    parts = [pieces(word) for word in words]
    allowed = {"".join(of[i:j]) for of in parts for i in range(len(of)) for j in range(i + 1, len(of) + 1)}
    assert [word for word in shown.split() if word not in allowed] == []


def test_room_goes_where_it_saves_lines() -> None:
    """Give a column with tall cells the room that a column with one word a line cannot use."""
    tall = Cell("contacts: 3.958 / 5.953 / 409 (capture); 0.7604 / 2.5 / 5 (timed)", notes=("counted at 6 steps",))
    rows = [["brax [solver=positional]", "none", tall, "the engine does not tell of any"]] * 4
    shown = printed(Document("", (table("t", "", ["group", "actions", "counted", "overflow"], rows),)))
    assert len(shown.splitlines()) <= 1 + 3 * len(rows)


def test_numbers_of_a_figure_are_in_the_page_as_csv() -> None:
    drawn = Markup('<svg viewBox="0 0 1 1"><text>a</text></svg>')
    figure = Figure("a", "b", drawn, "key of it", Numbers(["x", "<y>"], [[1, 2.5], ["<b>", None]]))
    page = render_page(Document("t", (figure,)))
    assert "<pre hidden>x,&lt;y&gt;\n1,2.5\n&lt;b&gt;,\n</pre>" in page
    assert 'data-file="key-of-it"' in page


def test_walking_meets_every_block_once() -> None:
    kinds = [type(one).__name__ for one in walk(document_of("X").blocks)]
    assert sorted(kinds) == sorted(
        ["Table", "Section", "Text", "Facts", "Code", "Items", "Beside", "Text", "Items", "Gallery", "Figure", "Embed"]
    )  # fmt: skip


def test_a_key_is_letters_digits_and_hyphens() -> None:
    assert key_of("../../etc", "Passwd ü", 3) == "etc-passwd-3"
    assert key_of("***") == "figure"
    assert len(key_of("a" * 500)) == 80


@needs_chromium
def test_a_page_sorts_filters_searches_and_opens_what_a_link_names(tmp_path: Path) -> None:
    rows = [
        Row((Cell(name), Cell(f"{value:g}", value)), {"simulator": name.split()[0]})
        for name, value in (("a one", 9.0), ("b two", 10.0), ("a three", 1.5))
    ]
    folded = Section("deep", "Deep", (table("t", "T", ["group", "value"], [*rows, ["none", "-"]]),), folded=True)
    other = Section("other", "Other", (Text("nothing of that kind"),), folded=True)
    page = tmp_path / "page.html"
    page.write_text(render_page(Document("t", (folded, other))))

    def names(browser: Browser) -> object:
        return browser.evaluate("[...document.querySelectorAll('tbody tr:not(.out) th')].map(e => e.textContent)")

    with Browser() as browser:
        browser.open(page)
        assert browser.evaluate("document.querySelector('details').open") is False
        browser.evaluate("location.hash = '#deep'")
        browser.wait("document.querySelector('details').open")
        browser.evaluate("document.querySelectorAll('thead button')[1].click()")
        assert names(browser) == ["b two", "a one", "a three", "none"]
        browser.evaluate("document.querySelectorAll('thead button')[1].click()")
        assert names(browser) == ["a three", "a one", "b two", "none"]
        browser.evaluate(
            "(e => { e.value = 'a'; e.dispatchEvent(new Event('change')); })(document.querySelector('select'))"
        )
        assert names(browser) == ["a three", "a one", "none"]
        browser.evaluate(
            "(e => { e.value = 'THREE'; e.dispatchEvent(new Event('input')); })(document.querySelector('input'))"
        )
        browser.wait("document.querySelector('output').textContent.startsWith('1 section has')")
        assert names(browser) == ["a three"]
        assert browser.evaluate("document.querySelector('#other').closest('details').classList.contains('out')") is True


def long_table(n: int) -> Document:
    """A closed section with a table of `n` rows: each with a note, the last with more below it."""
    rows = [
        Row((Cell(f"row {i}", notes=(f"note {i}",)), Cell(str(i), float(i), (0.0, 9.0), "[0, 9]"))) for i in range(n)
    ]
    last = Row(rows[-1].cells, {}, (Section("inside", "Inside", (Text("more of the last"),)),))
    shown = table("t", "T", ["group", "value"], [*rows[:-1], last], ["one", "two", "three"])
    return Document("t", (Section("deep", "Deep", (shown,), folded=True),))


def test_few_rows_are_open_and_many_are_closed() -> None:
    few = table("t", "T", ["group"], [[Cell("a", notes=("n",))]] * 4)
    assert "class=row" not in render_page(Document("t", (few,))).partition("<main")[2].partition("<script>")[0]
    many = table("t", "T", ["group"], [[Cell("a", notes=("n",))]] * 5)
    assert render_page(Document("t", (many,))).count("<details class=row>") == 5


@needs_chromium
@pytest.mark.parametrize("scripts", [True, False], ids=["scripts", "none"])
def test_rows_and_the_rest_of_a_table_open_on_demand(tmp_path: Path, scripts: bool) -> None:
    """Show 25 of 40 rows, a line each; open a row for its notes, and the table for all rows, without a script too."""
    page = tmp_path / "page.html"
    page.write_text(render_page(long_table(40)))
    shown = "[...document.querySelectorAll('tbody tr')].filter(e => e.checkVisibility()).length"
    note = "[...document.querySelectorAll('th > small')].filter(e => e.checkVisibility()).map(e => e.textContent)"
    with Browser() as browser:
        browser.open(page, scripts=scripts)
        for selector in ("#deep", "th summary"):
            browser.evaluate(f"document.querySelector('{selector}').closest('summary').focus()")
            browser.key("Enter")
        assert (browser.evaluate(shown), browser.evaluate(note)) == (25, ["note 0"])
        browser.evaluate("document.querySelector('.every summary').focus()")
        browser.key("Enter")
        assert browser.evaluate(shown) == 40
        browser.evaluate("[...document.querySelectorAll('th summary')].at(-1).focus()")
        browser.key("Enter")
        assert browser.evaluate(shown) == 41
        assert browser.evaluate(note) == ["note 0", "note 39"]


@needs_chromium
def test_rows_keep_what_is_below_them_and_are_found_wherever_they_are(tmp_path: Path) -> None:
    """Sort a row with what it holds, search rows that are not shown, and open all that a link's target stands in."""
    page = tmp_path / "page.html"
    page.write_text(render_page(long_table(40)))
    with Browser() as browser:
        browser.open(page)
        browser.evaluate("document.querySelectorAll('thead button')[1].click()")
        bodies = "[...document.querySelectorAll('tbody')]"
        order = f"{bodies}.map(b => [...b.rows].map(r => r.className || r.cells[1].dataset.v))"
        first, rest = browser.evaluate(order)
        assert first[:3] == ["39", "more", "38"]
        assert (len(first), len(rest)) == (26, 15)
        browser.evaluate("document.querySelectorAll('thead button')[1].click()")
        assert browser.evaluate(order)[1][-2:] == ["39", "more"]
        browser.evaluate("location.hash = '#inside'")
        browser.wait("document.getElementById('inside').checkVisibility()")
        browser.evaluate("document.querySelectorAll('details').forEach(d => { d.open = d.matches(':has(#deep)'); })")
        browser.evaluate(
            "(e => { e.value = 'row 34'; e.dispatchEvent(new Event('input')); })(document.querySelector('input'))"
        )
        browser.wait("document.querySelector('output').textContent")
        found = "[...document.querySelectorAll('tbody th')].filter(e => e.checkVisibility())"
        assert browser.evaluate(f"{found}.map(e => e.textContent)") == ["row 34note 34"]


@needs_chromium
@pytest.mark.parametrize("width", [400, 1280, 1920])
def test_names_and_intervals_do_not_widen_a_page(tmp_path: Path, width: int) -> None:
    """Break nothing out of the page with names of ninety characters and a dozen columns with intervals."""
    value = Cell("1234.567 ± 89.012", 1.0, (0.0, 2.0), "[1000.123, 2000.456]")
    rows = [[Cell("engine [" + "option=value, " * 5 + f"{i}]", notes=("n",)), *[value] * 11] for i in range(30)]
    shown = table("t", "T", ["group", *(f"quantity {i} [cm]" for i in range(11))], rows)
    page = tmp_path / "page.html"
    page.write_text(render_page(Document("t", (shown,))))
    with Browser() as browser:
        browser.open(page, width=width)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        assert browser.evaluate("(e => e.scrollWidth - e.clientWidth)(document.querySelector('.table'))") <= 1


def test_figures_and_lists_beyond_the_first_are_closed() -> None:
    figures = tuple(Figure(f"figure {i}", "", Markup("<svg></svg>")) for i in range(10))
    shown = render_page(Document("t", (Gallery(figures), items(*(f"item {i}" for i in range(20))))))
    first, _, rest = shown.partition("Show all 10 figures")
    assert ("figure 5" in first, "figure 6" in first, "figure 9" in rest) == (True, False, True)
    first, _, rest = rest.partition("Show all 20")
    assert ("item 7" in first, "item 8" in first, "item 19" in rest) == (True, False, True)
