"""A manual page of every command, made of its own help: python docs/make_man.py man, then man man/gsb-eval.1"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import make_reference  # noqa: E402 - a script beside this one

from gpusimbench import schemas  # noqa: E402

_TITLES = {"exit codes": "exit status", "environment variables": "environment"}
_AFTER = ("files", "environment variables", "examples", "see also")
"""Sections whose place is at the end of a manual page."""


def man_page(name: str, parser: argparse.ArgumentParser) -> str:
    """The page in roff, as man(7) describes it."""
    description, verbs = str(parser.description), make_reference.verbs(parser)
    summary = re.split(r"[.;,] ?", description)[0]
    lines = [
        f'.TH {name.upper()} 1 "" "gpusimbench {schemas.__version__}" "Commands of gpusimbench"',
        ".SH NAME",
        f"{_roff(name)} \\- {_roff(summary[0].lower() + summary[1:])}",
        ".SH SYNOPSIS",
        ".nf",
        *(_line(line) for each in (parser, *verbs.values()) for line in make_reference.usage(each).splitlines()),
        ".fi",
        ".SH DESCRIPTION",
        _line(description),
        *_options(parser),
    ]
    for verb, below in verbs.items():
        lines += [f".SH {_roff(f'{name} {verb}'.upper())}", _line(str(below.description))]
        lines += _options(below, heading=".SS")
    found = make_reference.sections(parser.epilog or "")
    for title in [*(t for t in found if t not in _AFTER), *(t for t in _AFTER if t in found)]:
        if found[title].strip():
            lines += [f".SH {_roff(_TITLES.get(title, title or 'notes').upper())}", ".nf"]
            lines += [*map(_line, found[title].strip("\n").splitlines()), ".fi"]
    return "\n".join(lines) + "\n"


def _options(parser: argparse.ArgumentParser, heading: str = ".SH") -> Iterator[str]:
    for group, rows in make_reference.options_of(parser):
        yield f"{heading} {_roff(group.upper())}"
        for names, meaning in rows:
            yield from (".TP", f".B {_roff(', '.join(names))}", _line(meaning))


def _roff(text: str) -> str:
    return text.replace("\\", "\\e").replace("-", "\\-")


def _line(text: str) -> str:
    # a point or an apostrophe at the start of a line would be taken for a request
    return re.sub(r"^([.'])", r"\\&\1", _roff(text))


def main() -> None:
    """Write all pages into a folder."""
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name, parser in make_reference.parsers().items():
        (folder / f"{name}.1").write_text(man_page(name, parser), encoding="utf-8")


if __name__ == "__main__":
    main()
