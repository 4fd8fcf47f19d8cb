"""Completion of a command's arguments by the user's shell, made of the command's own parser."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module

SHELLS = ("bash", "zsh", "fish", "tcsh")

Names = Callable[[], Mapping[str, tuple[str, ...]]]

_PATTERNS = {
    "FILE": ("*.mcap", "*.mcap.partial"),
    "SET": ("*.mcap", "*.mcap.partial"),
    "CSV": ("*.csv",),
    "FILE.svg": ("*.svg",),
}
"""Names of files that an argument takes, by its metavar. A FILE is a recording where its help does not say "write"."""


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
