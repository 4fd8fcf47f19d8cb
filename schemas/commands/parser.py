"""The parser of every command: a short help and a whole one, options and sections that every command has, completion,
and errors that suggest what may have been meant."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NoReturn

from gpusimbench import schemas
from gpusimbench.schemas.location import redacted
from gpusimbench.schemas.text import did_you_mean, line

_EXAMPLES = "\nexamples:\n"
_WIDTH = 118


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose --help shows the options that most people need, and whose --help-all shows all.

    A mistyped option, verb or choice ends with the message that argparse has for it and the nearest known name.
    """

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._first: list[argparse.Action] = []

    def show_first(self, *names: str) -> None:
        """Name the options that --help shows, beside those without dashes; the others are left to --help-all.

        KeyError for an option that the parser does not have.
        """
        options = self._option_string_actions
        self._first = [options["--help"], options["--help-all"], *(options[name] for name in names)]

    def format_usage(self) -> str:
        """See ArgumentParser.format_usage; of the options, those that --help shows."""
        with self._without(self._rare()):
            return super().format_usage()

    def format_help(self) -> str:
        """See ArgumentParser.format_help; of the options, those that --help shows, and of the sections the examples."""
        rare = self._rare()
        if not rare:
            return super().format_help()
        whole = self.epilog or ""
        before, heading, examples = whole.partition(_EXAMPLES)
        titles = [text[:-1] for text in before.splitlines() if text.endswith(":") and not text.startswith(" ")]
        more = f"{self.prog} --help-all shows {len(rare)} more options, and the sections {', '.join(titles)}."
        with self._without(rare):
            self.epilog = heading.lstrip("\n") + examples.rstrip("\n") + "\n\n" + textwrap.fill(more, _WIDTH) + "\n"
            try:
                return super().format_help()
            finally:
                self.epilog = whole

    def format_whole_help(self) -> str:
        """The help with every option and every section."""
        kept, self._first = self._first, []
        try:
            return self.format_help()
        finally:
            self._first = kept

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """See ArgumentParser.parse_args."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            known = [name for parser in self._parsers(found) for name in parser._option_string_actions]
            written = [text.partition("=")[0] for text in unknown if text.startswith("--")]
            hint = next(filter(None, (did_you_mean(name, known) for name in written)), "")
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return found

    def error(self, message: str) -> NoReturn:
        """See ArgumentParser.error; an argument may be an address with a password, which is not shown."""
        super().error(line(redacted(message)))

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += did_you_mean(str(value), map(str, action.choices or ()))
            raise

    def _rare(self) -> list[argparse.Action]:
        if not self._first:
            return []
        return [action for action in self._actions if action.option_strings and action not in self._first]

    def _parsers(self, found: argparse.Namespace) -> Iterator[argparse.ArgumentParser]:
        # this parser, and that of the verb that was given
        yield self
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                verb = getattr(found, action.dest, None)
                if verb in action.choices:
                    yield action.choices[verb]

    @contextmanager
    def _without(self, actions: Iterable[argparse.Action]) -> Iterator[None]:
        kept = [(action, action.help) for action in actions]
        for action, _ in kept:
            action.help = argparse.SUPPRESS
        try:
            yield
        finally:
            for action, text in kept:
                action.help = text


class HelpAll(argparse.Action):
    """--help-all: print the whole help and end."""

    def __init__(self, option_strings: list[str], dest: str, help: str) -> None:  # noqa: A002 - argparse's
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, default=argparse.SUPPRESS, help=help)

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: object, values: object, option_string: str | None = None
    ) -> None:
        """See argparse.Action."""
        assert isinstance(parser, Parser)
        parser._print_message(parser.format_whole_help(), sys.stdout)
        parser.exit()


SHELLS = ("bash", "zsh", "fish", "tcsh")

Names = Callable[[], Mapping[str, tuple[str, ...]]]

_PATTERNS = {
    "FILE": ("*.mcap", "*.mcap.partial"),
    "SET": ("*.mcap", "*.mcap.partial"),
    "CSV": ("*.csv",),
    "FILE.svg": ("*.svg",),
}
"""Names of files that an argument takes, by its metavar. A FILE is a recording where its help does not say "write"."""

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
