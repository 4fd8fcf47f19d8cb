"""Text of strangers, made harmless to whatever shows it: a line is one line, a block is lines of our own.

Nothing else is printed: `show` and `evaluator.render.console` take these and make nothing else of text.
"""

from __future__ import annotations

import codecs
import io
import math
import re
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cache

live: AbstractContextManager[None] = nullcontext()
"""Entered whenever something is printed: it takes a line of schemas.commands.progress off the terminal."""


SIGNS = "gpusimbench-signs"
"""Of `codecs`: what a stream writes for a sign that its encoding does not have."""

_IN_ASCII = {
    "±": "+-", "µ": "u", "×": "x", "−": "-", "–": "-", "≤": "<=", "≥": ">=", "→": "->", "…": "...", "†": "+", "·": ".",
    "°": " deg", "“": '"', "”": '"',
    **dict(zip("▁▂▃▄▅▆▇█", "12345678", strict=True)), **{sign: f"^{n}" for n, sign in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")},
}  # fmt: skip


def _without_signs(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    lacking = error.object[error.start : error.end]
    return "".join(_IN_ASCII.get(s) or s.encode("ascii", "backslashreplace").decode() for s in lacking), error.end


codecs.register_error(SIGNS, _without_signs)


class Line(str):
    """Text on one line, every character of which can be seen."""

    __slots__ = ()


class Block(str):
    """Lines, each with its line break."""

    __slots__ = ()


def line(text: str) -> Line:
    """Text on one line: line breaks, and everything else that moves or hides text, become visible escapes.

    So do words that make a line a command of a CI service, which reads what is printed in its logs.
    """
    if type(text) is Line:
        return text
    shown = text if _plain(text) else "".join(map(_in_line, text))
    if "::" in shown or "##" in shown:
        shown = _COMMAND.sub(lambda found: f"\\x{ord(found[0]):02x}", shown)
    return Line(shown)


def block(lines: Iterable[str]) -> Block:
    """Lines, each made as by `line`."""
    return Block("".join(f"{line(one)}\n" for one in lines))


def printable(text: str) -> str:
    """Text for a page, where lines end by markup and no line break ends anything: as `line`, but \\n stays.

    It is never printed.
    """
    return text if _plain(text) else "".join(c if c == "\n" else _in_line(c) for c in text)


def stored_text(text: str) -> str:
    """Text as UTF-8 can have it: bytes of a path in another encoding are written as escapes."""
    return text.encode("utf-8", "backslashreplace").decode()


def cut(text: str, most: int) -> str:
    """Text of at most so many characters: the end of a longer text is replaced by "..."."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def first(parts: Sequence[str], most: int, what: str = "") -> list[str]:
    """The first of some parts, and one that says how many more there are: "a", "b", "and 3 more"."""
    more = len(parts) - most
    return [*parts[:most], *([f"and {more:,} more{what}"] if more > 0 else [])]


def few(names: Sequence[str], most: int, what: str = "", *, by: str = ", ") -> str:
    """The first of some names in a line: "a, b and 3 more"."""
    shown = first(names, most, what)
    return by.join(shown) if len(names) <= most else f"{by.join(shown[:-1])} {shown[-1]}"


def in_ranges(numbers: Sequence[int], *, at_most: int) -> str:
    """Increasing numbers as "0, 3-5, 8", at most so many parts and then "..."."""
    parts: list[list[int]] = []
    for n in numbers:
        if parts and n == parts[-1][-1] + 1:
            parts[-1] = [parts[-1][0], n]
        else:
            parts.append([n, n])
    # two neighbours are written one by one
    said = [f"{a}" if a == b else f"{a}, {b}" if b == a + 1 else f"{a}\u2013{b}" for a, b in parts[:at_most]]
    return ", ".join([*said, *(["..."] if len(parts) > at_most else [])])


def plural(number: int, what: str, several: str = "", *, spec: str = "") -> str:
    """A number of things: "1 run", "2 runs".

    several  the plural of a word that takes more than an s
    spec     format of the number, such as "," for 1,000
    """
    return f"{number:{spec}} {what if number == 1 else several or f'{what}s'}"


def ordinal(number: int) -> str:
    """A place in a row: "1st", "2nd", "3rd", "4th", "11th", "22nd"."""
    ends = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if number // 10 % 10 == 1 else ends.get(number % 10, 'th')}"


def percent(share: float) -> str:
    """A share in whole percent; 0 % and 100 % are said of exact values alone."""
    if 0 < share < 0.005:
        return "less than 1 %"
    return "more than 99 %" if 0.995 <= share < 1 else f"{100 * share:.0f} %"


def bound(share: float) -> str:
    """An upper bound of a share in percent, rounded up: to a whole number, or to two digits if it is less than 10 %."""
    percents = float(f"{100 * share:.12g}")  # 29 %, and not 29.000000000000004 %
    digits = 10 ** (1 - math.floor(math.log10(percents))) if 0 < percents < 10 else 1.0
    return f"{math.ceil(percents * digits) / digits:.{2 if percents < 10 else 3}g} %"


def show(text: Line | Block, *, error: bool = False) -> None:
    """Print a line, or lines, on standard output, or on standard error; whoever reads them gets them at once."""
    stream = sys.stderr if error else sys.stdout
    with live:
        stream.write(text if isinstance(text, Block) else f"{text}\n")
        stream.flush()


def write_every_sign() -> None:
    """Have standard output and error write in ASCII what their encoding lacks, so that a terminal without ± still gets
    its table; what has no such form becomes an escape."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=SIGNS)


def show_document(text: str) -> None:
    """Print JSON on standard output. What a CI service takes for a command is written as JSON's own escape."""
    sys.stdout.write(re.sub("#(?=#)", r"\\u0023", text))


def did_you_mean(given: str, known: Iterable[str]) -> str:
    """The end of a message on an unknown name, such as "; did you mean 'mujoco'?"; empty where no name is similar.

    Names are compared without regard to case, hyphens and underscores. A name that begins as the given one is similar.
    """
    from difflib import get_close_matches

    names: dict[str, str] = {}
    for name in known:
        names.setdefault(_folded(name), name)
    wanted = _folded(given)
    begun = [name for name in names if len(wanted) > 1 and name.startswith(wanted)]
    near = list(dict.fromkeys([*get_close_matches(wanted, names, n=_MOST_NAMES), *begun]))[:_MOST_NAMES]
    return f"; did you mean {' or '.join(repr(names[name]) for name in near)}?" if near else ""


_MOST_NAMES = 3  # are suggested
_COMMAND = re.compile(
    # of GitHub Actions at the beginning of a line, which a terminal's or a table's edge can make anywhere; of Azure
    # Pipelines, TeamCity and older GitHub runners anywhere
    r":(?=:(?:add-mask|add-matcher|add-path|debug|echo|endgroup|error|group|internal-set-repo-path|notice|remove-matcher"
    r"|save-state|set-env|set-output|stop-commands|warning)(?:[\s:]|$))|#(?=#[a-z]*\[)",
    re.IGNORECASE,
)

_HIDDEN = frozenset(("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"))

_INVISIBLE = frozenset((
    0x034F, 0x115F, 0x1160, 0x17B4, 0x17B5, 0x2800, 0x3164, 0xFFA0,  # joiners, fillers and blanks that are letters
    *range(0x180B, 0x1810), *range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0),  # variation selectors
))  # fmt: skip

_SHORT = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}


def _plain(text: str) -> bool:
    return text.isascii() and text.isprintable()


@cache
def _in_line(character: str) -> str:
    code = ord(character)
    if unicodedata.category(character) not in _HIDDEN and code not in _INVISIBLE:
        return character
    if character in _SHORT:
        return _SHORT[character]
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _folded(name: str) -> str:
    return name.lower().replace("_", "-")
