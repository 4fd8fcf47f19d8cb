"""What the commands of recorder and evaluator have in common: options, and sections of their help."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module

from gpusimbench import schemas
from gpusimbench.schemas.commands.parser import HelpAll, Parser

SHELLS = ("bash", "zsh", "fish", "tcsh")

Names = Callable[[], Mapping[str, tuple[str, ...]]]

_PATTERNS = {
    "FILE": ("*.mcap", "*.mcap.partial"),
    "SET": ("*.mcap", "*.mcap.partial"),
    "CSV": ("*.csv",),
    "FILE.svg": ("*.svg",),
}
"""Names of files that an argument takes, by its metavar. A FILE is a recording where its help does not say "write"."""

_WIDTH = 118

VARIABLES = {
    "CUDA_VISIBLE_DEVICES": "the first GPU that it names is the one that engines step on and whose memory is read",
    "GSB_CACHE": "where results are kept without --cache (default: gpusimbench in $XDG_CACHE_HOME or ~/.cache)",
    "GSB_CUBE_TOSS": "the measured tosses of scene cube-toss, where --tosses does not say",
    "GSB_ENVIRONMENTS": "where --setup makes environments (default: gpusimbench/environments in $XDG_DATA_HOME or "
    "~/.local/share)",
    "GSB_MADRONA_MODULE": "the simulator module of --sim madrona, where --option module=NAME does not say",
    "GSB_PROGRESS": "off: no lines on standard error that say how far the command is and how much time is left",
    "OMP_NUM_THREADS": "threads that distances are computed with (default: as many as the process may use)",
    "TMPDIR": "where a recording from elsewhere lies while it is verified; it needs room for all of it (default: /tmp)",
}
"""Variables of the environment that commands read."""


class PrintCompletion(argparse.Action):
    """--print-completion SHELL: print the script and end, as --version does.

    names  gives, by the destination of an option, names that only this machine knows, such as simulators; asked for
           when the script is printed
    """

    def __init__(self, option_strings: list[str], dest: str, names: Names, help: str) -> None:  # noqa: A002 - argparse's
        super().__init__(option_strings, argparse.SUPPRESS, choices=SHELLS, metavar="SHELL", help=help)
        self._names = names

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: object, values: object, option_string: str | None = None
    ) -> None:
        """See argparse.Action."""
        try:
            shtab = import_module("shtab")
        except ImportError:
            parser.error("--print-completion needs the package shtab: pip install shtab")
        names = self._names()
        for action in _actions(parser):
            action.choices = names.get(action.dest, action.choices)
            if kind := _files(action):
                action.complete = {"folder": shtab.DIRECTORY, "file": shtab.FILE}.get(kind[0]) or shtab.glob(*kind)  # type: ignore[attr-defined]
        parser._print_message(shtab.complete(parser, str(values)) + "\n", sys.stdout)
        parser.exit()


def _actions(parser: argparse.ArgumentParser) -> Iterable[argparse.Action]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)
        else:
            yield action


def _files(action: argparse.Action) -> tuple[str, ...]:
    # "file", "folder", patterns, or nothing
    if action.metavar == "DIR":
        return ("folder",)
    if action.metavar in ("PATH", "NAME|FILE") or (action.metavar == "FILE" and "write" in (action.help or "")):
        return ("file",)
    return _PATTERNS.get(str(action.metavar), ())


def add_common(parser: Parser, names: Names = dict, reads: Iterable[str] = ()) -> None:
    """Give a parser the options that every command has, and its help the section on its environment.

    The section stands before "see also:" of the parser's epilog.

    names  see PrintCompletion
    reads  variables of the environment that the command reads, as VARIABLES has them
    """
    parser.add_argument("--help-all", action=HelpAll, help="show every option and every section of this help, and exit")
    parser.add_argument(
        "--version",
        action="version",
        version=f"gpusimbench {schemas.__version__}",
        help="show the version of the package and exit",
    )
    parser.add_argument(
        "--print-completion",
        action=PrintCompletion,
        names=names,
        help=f"print a script that completes this command in {', '.join(SHELLS)}, and exit",
    )
    if rows := "".join(_item(f"{name}  {VARIABLES[name]}") for name in reads):
        before, heading, after = (parser.epilog or "").partition("\nsee also:\n")
        parser.epilog = f"{before}\nenvironment variables:\n{rows}{heading}{after}"


def _item(text: str) -> str:
    return textwrap.fill(text, _WIDTH, initial_indent="  ", subsequent_indent="      ") + "\n"
