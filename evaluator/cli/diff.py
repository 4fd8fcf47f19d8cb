"""gsb-diff: the first step at which two recordings, or environments of one, differ."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import (
    add_json,
    answer,
    check_target,
    complain,
    entry_point,
    local_path,
    new_parser,
)
from gpusimbench.schemas.commands.progress import stage
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.location import place
from gpusimbench.schemas.text import plural
from gpusimbench.schemas.writing import write_file

if TYPE_CHECKING:
    from gpusimbench.evaluator.diff.result import Difference
    from gpusimbench.evaluator.read.recording import Recording

_EPILOG = """\
exit codes:
  0  nothing differs: all that was compared is bit-identical, or, where bits cannot be compared, within the resolution
  1  the results cannot be written
  2  wrong usage
  3  a file is damaged or not a recording; or nothing differs in what is there, but a recording is cut short or lost
     data
  4  they differ
  5  they have nothing in common that could be compared

see also:
  gsb-audit, which replays first
  gsb-eval, for sets of runs
  docs/diff.md

examples:
  gsb-diff before.mcap after.mcap
  gsb-diff run.mcap
  gsb-diff run.mcap --env 0 --env 5
  gsb-diff before.mcap after.mcap --json - | jq .first
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-diff",
        "Find the first step, environment, body and number in which two recordings, or the environments of one, "
        "differ, and how fast the difference grows.",
        _EPILOG,
    )
    p.add_argument(
        "files", nargs="+", type=place, metavar="FILE", help="one or two recordings (.mcap), addresses, or folders"
    )
    p.add_argument(
        "--env", type=int, action="append", default=[], metavar="E",
        help="environment to compare; with one recording, give it twice; with two, once for the same environment of "
        "both, or twice for one of each (default: all environments)",
    )  # fmt: skip
    add_json(p, "result")
    p.add_argument("--all", action="store_true", help="print every field, distance, class and setting")
    p.add_argument("--plot", type=local_path, metavar="FILE.svg", help="draw how the difference grows")
    p.add_argument("--no-verify", action="store_true", help="skip the digests; CRCs of what is read are still checked")
    return p


def run(arguments: argparse.Namespace) -> int:
    """Compare and print; returns the exit code."""
    from gpusimbench.evaluator.diff.sections import diff_document, dump_json
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.read.recording import Recording
    from gpusimbench.evaluator.runs.validation import verified

    arguments.files = expand(arguments.files, copies=True)
    _check(arguments)
    recordings = [Recording(path) for path in arguments.files] if arguments.no_verify else verified(arguments.files)
    with stage("comparing states"):
        found = _compare(recordings, arguments.env)
    if arguments.plot:
        from gpusimbench.evaluator.diff.figure import figure_of

        drawn = figure_of(found)
        if drawn:
            write_file(arguments.plot, drawn)
        else:
            complain("gsb-diff", f"no difference to draw; {arguments.plot} was not written")
    answer(arguments.json, lambda: dump_json(found), lambda: diff_document(found, every=arguments.all))
    return _exit_code(found)


def _check(arguments: argparse.Namespace) -> None:
    files, envs = len(arguments.files), len(arguments.env)
    if files > 2:
        raise UsageError(
            f"gsb-diff compares two recordings, or one with itself; {files} recordings were given. gsb-eval says "
            "whether runs repeat, gsb-compare BASE HEAD compares two folders"
        )
    if envs > 2 or (files == 1 and envs == 1):
        raise UsageError(
            f"{plural(envs, 'environment')} given: with one recording give --env twice, with two "
            "recordings once or twice"
        )
    if arguments.plot and arguments.plot.suffix != ".svg":
        raise UsageError(f"--plot draws SVG; name the file .svg instead of {arguments.plot.name}")
    check_target(arguments.json)


def _compare(recordings: list[Recording], envs: list[int]) -> Difference:
    from gpusimbench.evaluator.diff.compare import compare, compare_all_envs, compare_envs

    if len(recordings) == 1:
        return compare_envs(recordings[0], *envs) if envs else compare_all_envs(recordings[0])
    return compare(*recordings, envs=(envs[0], envs[-1]) if envs else None)


def _exit_code(found: Difference) -> int:
    if found.different:
        return int(ExitCode.GATE_FAILED)
    return int(ExitCode.DATA_LOST if found.lost else ExitCode.OK)


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
