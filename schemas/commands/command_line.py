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

_VARIABLES = {
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

_READS = {
    "gsb-record": ("CUDA_VISIBLE_DEVICES", "GSB_CUBE_TOSS", "GSB_ENVIRONMENTS", "GSB_MADRONA_MODULE", "GSB_PROGRESS"),
    "gsb-audit": ("CUDA_VISIBLE_DEVICES", "GSB_ENVIRONMENTS", "GSB_MADRONA_MODULE", "GSB_PROGRESS"),
    "gsb-eval": ("GSB_CACHE", "GSB_PROGRESS", "OMP_NUM_THREADS"),
    "gsb-compare": ("GSB_CACHE", "GSB_PROGRESS", "OMP_NUM_THREADS"),
    "gsb-info": ("GSB_PROGRESS", "TMPDIR"),
    "gsb-check": ("GSB_PROGRESS", "TMPDIR"),
    "gsb-diff": ("GSB_PROGRESS",),
    "gsb-episodes": ("GSB_PROGRESS",),
    "gsb-run": ("CUDA_VISIBLE_DEVICES", "GSB_PROGRESS"),
    "gsb-replay": ("GSB_PROGRESS",),
    "gsb-probe": ("CUDA_VISIBLE_DEVICES", "GSB_ENVIRONMENTS", "GSB_MADRONA_MODULE", "GSB_PROGRESS"),
    "gsb-fit": ("CUDA_VISIBLE_DEVICES", "GSB_CUBE_TOSS", "GSB_ENVIRONMENTS", "GSB_PROGRESS"),
    "gsb-import": ("CUDA_VISIBLE_DEVICES", "GSB_ENVIRONMENTS", "GSB_PROGRESS"),
    "gsb-bisect": ("CUDA_VISIBLE_DEVICES", "GSB_MADRONA_MODULE", "GSB_PROGRESS"),
    "gsb-view": ("GSB_PROGRESS",),
    "gsb-share": ("GSB_CACHE", "GSB_PROGRESS"),
}
"""Which of them each command reads."""

_FILES = {
    "gsb-record": (
        "OUT/SIM-SCENE-nN-rR-TIME.mcap  run R, begun at TIME (UTC); SIM with its solver and level of determinism",
        "OUT/NAME.mcap.partial  a run that is being made, or what a crash left of it, for gsb-share recover",
    ),
    "gsb-replay": (
        "NAME-replay.mcap  the replay, a recording like any other",
        "NAME.mcap  the recording that a data set becomes",
    ),
    "gsb-audit": ("OUT/NAME.mcap  a replay, a recording like any other",),
    "gsb-run": (
        "OUT/run-K/  a run: recordings that the program wrote, and output.txt, what it printed",
        "OUT/run-K/program.json  the command, and digests of the files that it names",
    ),
    "gsb-probe": ("OUT/NAME.mcap  a run, a recording like any other",),
    "gsb-fit": (
        "OUT/NAME.mcap  the reference, the start and the fitted options, recordings like any other",
        "OUT/evaluations.csv  a row for each evaluation",
    ),
    "gsb-import": ("OUT/NAME.mcap  a run, a recording like any other",),
    "gsb-bisect": (
        "OUT/VERSION/NAME.mcap  a run of that release, a recording like any other",
        "OUT/environments/VERSION  a virtual environment with that release",
    ),
    "gsb-eval": ("CACHE/  what was read and computed, by content and version; it may be deleted at any time",),
}
"""What commands leave on the disk without being told its name."""

_SEE_ALSO = {
    "gsb": "gsb-record and gsb-eval, which are gsb record and gsb eval; docs/tutorial.md; docs/index.md",
    "gsb-record": "gsb-eval, which computes what the runs show; gsb-audit, which replays and compares; "
    "docs/simulators.md; docs/timing.md",
    "gsb-eval": "gsb-record, which makes recordings; gsb-check, which holds them against rules; docs/metrics.md; "
    "docs/statistics.md",
    "gsb-info": "gsb-check, which says rule by rule what is wrong; docs/check.md; schemas/README.md",
    "gsb-check": "gsb-info, which shows one file; gsb-audit, which also runs it again; docs/check.md; "
    "docs/strangers.md",
    "gsb-diff": "gsb-audit, which replays first; gsb-eval, for sets of runs; docs/diff.md",
    "gsb-episodes": "gsb-info, which counts episodes; gsb-diff, which shows where two recordings part; "
    "docs/how-to/evaluate-a-policy.md; docs/how-to/record-your-task.md",
    "gsb-run": "gsb-diff, which compares two recordings; gsb-audit --command, which runs a program again; "
    "docs/how-to/is-my-training-reproducible.md; docs/how-to/record-your-task.md",
    "gsb-replay": "gsb-audit, which replays recordings of gsb-record; gsb-diff, which compares two recordings step by "
    "step; docs/how-to/will-my-dataset-replay.md; docs/how-to/record-your-task.md",
    "gsb-audit": "gsb-record --replay, which only replays; gsb-diff, which shows where two part; docs/audit.md",
    "gsb-compare": "gsb-eval, for one set; gsb-diff, for two files; docs/compare.md; docs/history.md; "
    "docs/how-to/ci.md",
    "gsb-probe": "gsb-record, which makes its runs; gsb-diff, which shows where two part; docs/probe.md",
    "gsb-fit": "gsb-record --fitted, which says what was fitted; gsb-eval; docs/how-to/cube-toss.md; docs/check.md",
    "gsb-import": "gsb-record --model, which makes its runs; gsb-probe; docs/how-to/my-robot.md; "
    "docs/how-to/what-the-importer-lost.md",
    "gsb-bisect": "gsb-diff, which shows where two releases part; gsb-compare; docs/bisect.md",
    "gsb-view": "gsb-diff, which says in numbers where two part; gsb-share viewer; docs/view.md; docs/viewers.md",
    "gsb-share": "gsb-check, for what recover made; docs/share.md; docs/dataset.md; docs/strangers.md",
}
"""Where each command's reader may go on."""


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


def add_common(parser: Parser, names: Names = dict) -> None:
    """Give a parser the options that every command has, and its help the sections on its environment and its kin.

    names  see PrintCompletion
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
    before, heading, examples = (parser.epilog or "").partition("\nexamples:\n")
    parser.epilog = before + _kin(parser.prog) + heading + examples


def _kin(command: str) -> str:
    sections = {
        "files": _FILES.get(command, ()),
        "environment variables": [f"{name}  {_VARIABLES[name]}" for name in _READS.get(command, ())],
        "see also": _SEE_ALSO[command].split("; ") if command in _SEE_ALSO else (),
    }
    return "".join(f"\n{title}:\n{''.join(map(_item, rows))}" for title, rows in sections.items() if rows)


def _item(text: str) -> str:
    return textwrap.fill(text, _WIDTH, initial_indent="  ", subsequent_indent="      ") + "\n"
