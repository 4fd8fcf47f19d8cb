"""gsb: all commands under one name, and what to do next in the present folder.

`gsb eval` is `gsb-eval`: the same code, arguments, help, output and exit codes. A command's module is imported when the
command is asked for; the recorder and the evaluator stay strangers to each other.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from gpusimbench.schemas.commands.output import let_readers_leave
from gpusimbench.schemas.commands.parser import Parser, add_common
from gpusimbench.schemas.text import block, show, write_every_sign


@dataclass(frozen=True)
class Command:
    """A verb of gsb: what it does in a few words, the module of its main, and that of its parser."""

    summary: str
    entry: str
    arguments: str = ""

    def main(self, argv: list[str]) -> int:
        """Do what the command of that name does; returns its exit code."""
        code: int = import_module(self.entry).main(argv)
        return code

    def parser(self) -> argparse.ArgumentParser:
        """All arguments of the command."""
        made: argparse.ArgumentParser = import_module(self.arguments or self.entry).parser()
        return made


_EVALUATOR = "gpusimbench.evaluator.cli"

COMMANDS = {
    "record": Command(
        "run a scene on a simulator and write recordings",
        "gpusimbench.recorder.cli",
        "gpusimbench.recorder.command.arguments",
    ),
    "eval": Command("speed, memory, determinism and physics of recordings", f"{_EVALUATOR}.eval"),
    "compare": Command("whether a second set of recordings is worse than the first", f"{_EVALUATOR}.compare"),
    "diff": Command("where two recordings, or environments of one, first differ", f"{_EVALUATOR}.diff"),
    "episodes": Command("success and return of a policy, alone or against another", f"{_EVALUATOR}.episodes"),
    "run": Command("whether a program does the same again, and what differs first", f"{_EVALUATOR}.run"),
    "replay": Command("whether recorded actions still lead to the recorded episodes", "gpusimbench.replay.cli"),
    "check": Command("whether recordings are whole and follow the rules", f"{_EVALUATOR}.check"),
    "audit": Command("check recordings and run them again on this machine", f"{_EVALUATOR}.audit"),
    "info": Command("what a recording is", f"{_EVALUATOR}.info"),
    "probe": Command("whether results depend on what should not matter", f"{_EVALUATOR}.probe"),
    "fit": Command("options of a simulator fitted to measured tosses", f"{_EVALUATOR}.fit"),
    "import": Command("what engines made of a model file, and what they lost of it", f"{_EVALUATOR}.imported"),
    "bisect": Command("which release of an engine changed what is recorded", f"{_EVALUATOR}.bisect"),
    "view": Command("recordings in motion", f"{_EVALUATOR}.view"),
    "share": Command("pack, recover, describe, verify and rank recordings", f"{_EVALUATOR}.share"),
}
"""By verb, in the order of the help."""

_EPILOG = """\
Without a verb, gsb says what can be done next with what is in the present folder. Each verb is a command by itself,
too: gsb eval is gsb-eval. Its options: gsb VERB --help, and gsb VERB --help-all.

exit codes:
  0  success; what else it means, and what 3, 4 and 5 mean, depends on the verb: gsb VERB --help-all
  1  something could not be written or started
  2  there is no such verb, or wrong usage of the verb's command

see also:
  gsb-record and gsb-eval, which are gsb record and gsb eval
  docs/tutorial.md
  docs/index.md

examples:
  gsb
  gsb record --sim mujoco
  gsb eval runs --html report
"""


def parser(*, whole: bool = True) -> Parser:
    """The command's arguments.

    whole  with those of every verb; else with the verbs' names alone, which imports no command
    """
    p = Parser(
        prog="gsb",
        description="Record robot simulators, and evaluate the recordings: all commands under one name.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_common(p, _names)
    verbs: Any = p.add_subparsers(dest="verb", metavar="VERB", title="verbs")
    for verb, command in COMMANDS.items():
        verbs.add_parser(verb, help=command.summary)
        if whole:
            verbs._name_parser_map[verb] = command.parser()
    return p


def _names() -> dict[str, tuple[str, ...]]:
    names: dict[str, tuple[str, ...]] = import_module("gpusimbench.recorder.command.arguments").names()
    return names


def main(argv: list[str] | None = None) -> int:
    """Entry point of gsb."""
    let_readers_leave()
    given = sys.argv[1:] if argv is None else argv
    if not given:
        from gpusimbench.next_steps import next_steps

        write_every_sign()
        show(block(next_steps()))
        return 0
    if command := COMMANDS.get(given[0]):
        return command.main(given[1:])
    parser(whole=given[0] == "--print-completion").parse_args(given)
    return 0


if __name__ == "__main__":
    sys.exit(main())
