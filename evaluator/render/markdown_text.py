r"""Text as Markdown that a person can read: a character is escaped only where Markdown would interpret it.

CommonMark and the extensions of GitHub, GitLab and pandoc are held off: emphasis, links, tables, HTML, mathematics,
mentions and addresses. Words, numbers, versions, file names and units stay as they are.
"""

from __future__ import annotations

import re

from gpusimbench.schemas.text import line

_APART = "\u200b"  # mentions and issues are looked for in what was rendered, so a space of no width parts them
_BACKSLASHED = frozenset("`*_[#+-.)>~")  # what a reader of the source knows behind a backslash; others are references

_PATTERN = r"""
  (?P<mention> @(?=[\w{]) | [\#!](?=\d) | \bGH-(?=\d) )
| (?P<emphasis> \*+ | _+ )
| \A (?: [-+](?=\ |\Z) | -(?=[-\ ]*\Z) | \d{1,9}[.)](?=\ |\Z) )     # a list or a rule
| \A (?: \#(?=\#*(?:\ |\Z)) | =(?==*\Z) ) | (?<=\ )\#(?=\#*\Z)      # a heading, and its end
| \A (?: > | \[(?=[\ X]\](?:\ |\Z)) | [:%~](?=\ |\Z) )             # a quotation, a task, a definition, a title
| [`\\|$] | ~(?=[^\ ]) | \^(?=[^\ ^]+\^)                            # code, a cell, mathematics, struck out, raised
| \[(?!(?!\^)[\w\ /%.,+=^·°-]*\](?![(\[{:]))                       # a link; `[cm]` is none
| <(?=[A-Za-z/!?]|\Z) | &(?=\#[0-9Xx]|[A-Za-z][A-Za-z0-9]*;)
| \{(?=[\w\#.%{=-])                                                # attributes, and what templates replace
| (?:(?<=http)|(?<=https)|(?<=ftp)):(?=//) | (?<![^\W_])www\.
"""
_MARKUP = re.compile(_PATTERN, re.VERBOSE | re.IGNORECASE)
_MARKUP_OR_HTML = re.compile(rf"{_PATTERN}| [<&]", re.VERBOSE | re.IGNORECASE)


def prose(text: str, *, html: bool = False) -> str:
    """Text of strangers on one line, for a paragraph, a heading, an item or a cell: no markup, mention or link.

    What moves or hides text becomes visible.

    html  for the inside of an element of HTML, where CommonMark knows no backslash and pandoc knows everything
    """
    shown = line(re.sub(r"[\t\n\r]", " ", text).strip(" "))

    def escaped(found: re.Match[str]) -> str:
        matched, before, behind = found[0], shown[: found.start()][-1:], shown[found.end() :][:1]
        if found["mention"]:
            return f"{matched}{_APART}"
        if found["emphasis"]:
            literal = before == behind == " " or (matched[0] == "_" and before.isalnum() and behind.isalnum())
            return matched if literal else "".join(_escape(one, html) for one in matched)
        return f"{matched[:-1]}{_escape(matched[-1], html)}"

    return (_MARKUP_OR_HTML if html else _MARKUP).sub(escaped, shown)


def code(text: str, *, cell: bool = False) -> str:
    """Text of strangers in a fixed font, in which nothing is markup; `cell` is for a table's."""
    shown = line(text).replace("|", "\\|") if cell else line(text)
    ticks = "`" * (_longest_run(shown) + 1)
    room = " " if shown[:1] in ("`", " ") or shown[-1:] == "`" else ""
    return f"{ticks}{room}{shown}{room}{ticks}" if shown else ""


def fenced(lines: tuple[str, ...]) -> list[str]:
    """Lines of code as they are: nothing is markup between fences, and no line has as many backticks as these."""
    shown = [line(one) for one in lines]
    fence = "`" * max(3, max(map(_longest_run, shown), default=0) + 1)
    return [fence, *shown, fence]


def _longest_run(text: str) -> int:
    return max(map(len, re.findall("`+", text)), default=0)


def _escape(character: str, html: bool) -> str:
    if character in _BACKSLASHED and not html:
        return f"\\{character}"
    return {"<": "&lt;", "&": "&amp;"}.get(character) or f"&#{ord(character)};"
