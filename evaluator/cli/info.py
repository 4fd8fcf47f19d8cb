"""gsb-info: what a recording is, on one screen."""

from __future__ import annotations

import argparse
import sys

from gpusimbench.evaluator.cli.command import add_json, check_target, complain, entry_point, new_parser, write_json
from gpusimbench.schemas.commands.progress import each, sizes
from gpusimbench.schemas.errors import ExitCode, GsbError
from gpusimbench.schemas.location import Place, place
from gpusimbench.schemas.text import block, show

_EPILOG = """\
exit codes:
  0  every file is a whole recording
  1  the results cannot be written
  2  wrong usage
  3  a file is damaged, cut short or not a recording; what can be read is shown

see also:
  gsb-check, which says rule by rule what is wrong
  docs/check.md
  schemas/README.md

examples:
  gsb-info recordings/mujoco-amd-r0.mcap
  gsb-info recordings/mujoco-amd-r0.mcap --all
  gsb-info --no-verify big.mcap
  gsb-info recordings/*.mcap --json -
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-info",
        "Show what a recording contains: simulator, scene, machine, times, states, and who made it. The whole file is "
        "verified.",
        _EPILOG,
        reads=("TMPDIR",),
    )
    p.add_argument(
        "files", nargs="+", type=place, metavar="FILE", help="recordings (.mcap), folders of them, or addresses"
    )
    p.add_argument(
        "--all", action="store_true", help="show everything that a file says about itself, and list its arrays"
    )
    add_json(p, "facts")
    p.add_argument(
        "--no-verify", action="store_true", help="skip digests and comparisons; CRCs of what is read are still checked"
    )
    return p


def run(arguments: argparse.Namespace) -> int:
    """Print a block for each file; returns the exit code."""
    from gpusimbench.evaluator.check.inspection import Inspection, inspect
    from gpusimbench.evaluator.check.integrity import examine
    from gpusimbench.evaluator.check.integrity.problem import DAMAGE
    from gpusimbench.evaluator.read.addresses import expand
    from gpusimbench.evaluator.render.terminal import print_document
    from gpusimbench.evaluator.report.info import dump_info, info_document

    check_target(arguments.json)
    found: list[Inspection] = []
    unreadable: list[tuple[Place, GsbError]] = []
    damaged = False
    files = expand(arguments.files)
    for path in each(files, "reading recordings", sizes(files)):
        examined = examine(path, verify=not arguments.no_verify)
        damaged |= examined.recording is None or bool(DAMAGE.intersection(examined.problems.kinds()))
        try:
            found.append(inspect(examined))
        except GsbError as error:
            complain("gsb-info", error.advised)
            unreadable.append((path, error))
            continue
        if arguments.json != "-":
            if len(found) > 1:
                show(block([""]))
            print_document(info_document(found[-1], every=arguments.all), sys.stdout)
    if arguments.json:
        write_json(arguments.json, dump_info(found, unreadable))
    return int(ExitCode.DATA_LOST if damaged else ExitCode.OK)


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
