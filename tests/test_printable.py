"""Text of strangers, as it is shown."""

from __future__ import annotations

import ast
import io
import unicodedata
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gpusimbench.evaluator.render.console import Screen, plain_table
from gpusimbench.schemas import text as texts
from gpusimbench.schemas.text import block, cut, few, first, line, ordinal, plural, printable

_ROOT = Path(__file__).parents[1]
_HIDDEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")
_LOOK_LIKE_NOTHING = (
    0x034F, 0x115F, 0x1160, 0x17B4, 0x17B5, 0x180B, 0x180D, 0x180F, 0x2800, 0xFE00, 0xFE0E, 0xFFA0,
)  # fmt: skip
"""Letters, marks and signs of Unicode, not among its controls, that show as nothing or as a blank."""
_TEXTS = st.text(st.characters() | st.sampled_from("\n\r\t\x85\u200b\u200e\u2028\ufeff\ufe0f\U000e0041:#[ "))


@pytest.mark.parametrize(
    ("sign", "shown"),
    [("\n", "\\n"), ("\r", "\\r"), ("\t", "\\t"), ("\x1b", "\\x1b"), ("\x85", "\\x85"), ("\u200b", "\\u200b"),
     ("\u200e", "\\u200e"), ("\u2028", "\\u2028"), ("\u202e", "\\u202e"), ("\u2066", "\\u2066"), ("\ufe0f", "\\ufe0f"),
     ("\ufeff", "\\ufeff"), ("\u3164", "\\u3164"), ("\U000e0041", "\\U000e0041"), ("\udcff", "\\udcff"),
     ("\x7f", "\\x7f"), ("\xad", "\\xad"), ("\u0600", "\\u0600"), ("\uffff", "\\uffff"), ("\U0001ffff", "\\U0001ffff"),
     *((chr(c), f"\\u{c:04x}") for c in _LOOK_LIKE_NOTHING)],
)  # fmt: skip
def test_what_moves_or_hides_text_is_shown(sign: str, shown: str) -> None:
    """Show line breaks, controls, format characters and halves of pairs as escapes; a page keeps its line breaks."""
    assert line(f"a{sign}b") == f"a{shown}b"
    assert printable(f"a{sign}b") == ("a\nb" if sign == "\n" else f"a{shown}b")


def test_counts_agree_with_their_nouns() -> None:
    """Give the singular of 1 alone, and the plural that a noun has."""
    assert [plural(number, "run") for number in (0, 1, 2)] == ["0 runs", "1 run", "2 runs"]
    assert [plural(number, "body", "bodies", spec=",") for number in (1, 4096)] == ["1 body", "4,096 bodies"]


def test_letters_stay() -> None:
    """Leave letters of any script and signs as they are, and text that was made a line before."""
    text = "é 中 ع ± × 10⁻³ \\n ::1 std::bad_alloc #7 🦾"
    beside_invisible = "\u034e\u0350\u115e\u1161\u17b3\u17b6\u180a\u1810\u27ff\u2801\u3163\u3165\ufe10\uff9f\uffa1"
    for shown in (text, beside_invisible):
        assert line(shown) == line(line(shown)) == printable(shown) == shown


@pytest.mark.parametrize(
    ("count", "parts", "shown"),
    [
        (0, [], ""),
        (1, ["a"], "a"),
        (2, ["a", "b"], "a; b"),
        (3, ["a", "b", "and 1 more apples"], "a; b and 1 more apples"),
        (4, ["a", "b", "and 2 more apples"], "a; b and 2 more apples"),
        (1002, ["a", "b", "and 1,000 more apples"], "a; b and 1,000 more apples"),
    ],
)
def test_the_first_of_many(count: int, parts: list[str], shown: str) -> None:
    """Show two of them, and count the others, of which there may be none."""
    names = ["a", "b", *"c" * (count - 2)][:count]
    assert first(names, 2, " apples") == parts
    assert few(names, 2, " apples", by="; ") == shown
    assert few(names, 2) == shown.replace(";", ",").removesuffix(" apples")


def test_a_text_that_is_cut() -> None:
    """Leave a text of the largest length, and end a longer one by dots that count."""
    assert [cut("abcdefg", most) for most in (8, 7, 6, 4)] == ["abcdefg", "abcdefg", "abc...", "a..."]


@given(_TEXTS)
def test_a_line_is_one_line(text: str) -> None:
    """Make one line of any text, in which every character can be seen, and the same again."""
    shown = line(text)
    assert len(shown.splitlines()) <= 1
    assert not any(unicodedata.category(c) in _HIDDEN for c in shown)
    assert line(str(shown)) == shown
    assert block([text, text]) == f"{shown}\n{shown}\n"


@pytest.mark.parametrize("command", ["::error::x", "::warning file=a,line=1::x", "::stop-commands::x", "::ADD-MASK::x"])
@pytest.mark.parametrize("before", ["", "  ", "name"])
def test_commands_of_ci_services_are_shown(command: str, before: str) -> None:
    """Let no text become a command in a log that a CI service reads, wherever a line is broken."""
    assert "::" not in line(before + command).removesuffix("::x")
    assert "##[" not in line(f"{before}###[error]")
    assert "##vso[" not in line(f"{before}##vso[task.complete]")


@given(st.lists(st.tuples(_TEXTS, _TEXTS), min_size=1, max_size=3), st.integers(10, 40))
def test_a_screen_shows_lines(rows: list[tuple[str, str]], width: int) -> None:
    """Begin no line with what a text goes on with, wherever it is broken."""
    stream = io.StringIO()
    screen = Screen(file=stream, width=width, color_system=None, highlight=False, markup=False, emoji=False)
    table = plain_table("", "title\nFORGED")
    for row in rows:
        screen.print(f"x{row[0]} {'FORGED ' * 20}\nFORGED", style="dim")
        table.add_row(f"x{row[0]}\nFORGED {'FORGED ' * 9}", row[1])
    screen.print(table)
    shown = stream.getvalue().split("\n")
    assert not any(one.startswith("FORGED") for one in shown)
    assert not any(unicodedata.category(c) in _HIDDEN for one in shown for c in one)


def test_places_in_a_row() -> None:
    """End a place in a row as one says it."""
    said = "1st 2nd 3rd 4th 10th 11th 12th 13th 21st 22nd 23rd 100th 101st 111th 113th"
    assert " ".join(map(ordinal, (1, 2, 3, 4, 10, 11, 12, 13, 21, 22, 23, 100, 101, 111, 113))) == said


def test_documents_are_no_commands(capsys: pytest.CaptureFixture[str]) -> None:
    """Print JSON that says the same, and is no command of a CI service."""
    texts.show_document('{"a": "\\\\##[error]###vso["}\n')
    assert capsys.readouterr().out == '{"a": "\\\\\\u0023#[error]\\u0023\\u0023#vso["}\n'


_PRINTERS = {
    "schemas/text.py",
    "evaluator/render/console.py",
    "schemas/commands/output.py",
    "recorder/sets/progress.py",
}


def _prints(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            said = ast.unparse(node.func)
            if said in ("print", "Console", "rich.table.Table", "rich.print") or said.endswith(
                ("stdout.write", "stderr.write", "stdout.buffer.write", "stderr.buffer.write", "stdout.writelines")
            ):
                yield node


def test_nothing_else_prints() -> None:
    """Print by the modules that take lines alone."""
    found = [
        f"{path.relative_to(_ROOT)}:{node.lineno}"  # type: ignore[attr-defined]
        for package in ("evaluator", "recorder", "schemas")
        for path in sorted((_ROOT / package).rglob("*.py"))
        if str(path.relative_to(_ROOT)) not in _PRINTERS
        for node in _prints(ast.parse(path.read_bytes()))
    ]
    allowed = ("recorder/cli.py", "recorder/environments/lock.py")  # what is interrupted before it has loaded; a tool
    assert [one for one in found if not one.startswith(allowed)] == []
