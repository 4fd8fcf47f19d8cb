"""gsb-fit: options of a simulator fitted to even tosses, and judged by odd ones."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gpusimbench.evaluator.cli.command import add_json, answer, check_target, entry_point, local_path, new_parser
from gpusimbench.schemas.commands.folder_lock import folder_lock
from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.errors import ExitCode, UsageError

_OUT = Path("fit")
_BUDGET = 40
_EPILOG = """\
gsb-fit records the scene cube-toss again and again with other values of the options, and searches those with the
smallest error of position on EVEN tosses. Numbers are moved by factors, from a tenth to ten times the start; an option
of several numbers, such as solref, is as many parameters. Then the start and the fitted options are compared on ODD
tosses, which the search never saw. "friction" is the coefficient of the scene, and not of a simulator.

In --out lie the reference, the recordings of the start and of the fitted options, and evaluations.csv with a row for
each evaluation. gsb-eval OUT compares the two on odd tosses, too.

exit codes:
  0  options were fitted, or the start is the best
  1  a run could not be recorded
  2  wrong usage
  3  a recording is damaged

files:
  OUT/NAME.mcap  the reference, the start and the fitted options, recordings like any other
  OUT/evaluations.csv  a row for each evaluation

see also:
  gsb-record --fitted, which says what was fitted
  gsb-eval
  docs/how-to/cube-toss.md
  docs/check.md

examples:
  gsb-fit --sim mujoco --parameters solref
  gsb-fit --sim warp --parameters friction --dt 0.0016891891891891892
  gsb-fit --sim mujoco --parameters friction,solref --option "solref=0.01 1" --tosses tosses_processed --budget 80
"""


def parser() -> Parser:
    """The command's arguments."""
    p = new_parser(
        "gsb-fit",
        "Fit options of a simulator to measured tosses of a cube: search on even tosses, judge by odd ones.",
        _EPILOG,
        reads=(
            "CUDA_VISIBLE_DEVICES",
            "GSB_CUBE_TOSS",
            "GSB_ENVIRONMENTS",
        ),
    )
    p.add_argument("--sim", required=True, metavar="NAME", help="simulator; see gsb-record --list")
    p.add_argument(
        "--parameters", required=True, metavar="NAME[,NAME]",
        help="options to fit, made of numbers; see gsb-record --list NAME; also friction, of the scene",
    )  # fmt: skip
    p.add_argument(
        "--option", action="append", default=[], metavar="NAME=VALUE",
        help="option of the simulator; of an option that is fitted, the start (default: the simulator's); repeatable",
    )  # fmt: skip
    p.add_argument(
        "--tosses", type=local_path, metavar="PATH",
        help="measured tosses, as of gsb-record (default: $GSB_CUBE_TOSS, or else a synthetic set)",
    )  # fmt: skip
    p.add_argument(
        "--dt", type=float, metavar="S", help="time step [s]: 1/148 s divided by a whole number (default: 1/148)"
    )
    p.add_argument(
        "--budget", type=int, default=_BUDGET, metavar="N", help="evaluations at most (default: %(default)s)"
    )  # fmt: skip
    p.add_argument("--out", type=Path, default=_OUT, metavar="DIR", help="of what is kept (default: %(default)s/)")
    add_json(p, "result")
    p.show_first("--sim", "--parameters", "--option", "--tosses", "--budget", "--out", "--json")
    return p


def run(arguments: argparse.Namespace) -> int:
    """Search, judge and print; returns the exit code."""
    from gpusimbench.evaluator.fit.document import dump_json, fit_document
    from gpusimbench.evaluator.fit.fitting import Asked, fit

    check_target(arguments.json)
    names = tuple(filter(None, (name.strip() for name in arguments.parameters.split(","))))
    if not names:
        raise UsageError("--parameters names no option")
    if arguments.dt is not None and not 0 < arguments.dt < 1:
        raise UsageError(f"--dt is a part of 1/148 s, not {arguments.dt:g}")
    given = _options(arguments.option)
    if arguments.budget < 2:
        raise UsageError(f"--budget is at least 2, the start and another evaluation, not {arguments.budget}")
    if arguments.out.exists() and any(arguments.out.iterdir()):
        raise UsageError(f"--out {arguments.out} is not empty: a fit needs a folder of its own")
    asked = Asked(
        arguments.sim, names, given, arguments.tosses, arguments.dt, arguments.budget, arguments.out
    )  # fmt: skip
    with folder_lock(arguments.out, "gsb-fit", "fits options"):
        found = fit(asked)
    answer(arguments.json, lambda: dump_json(found), lambda: fit_document(found))
    return int(ExitCode.OK)


def _options(pairs: list[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name or name in found:
            raise UsageError(f"--option wants NAME=VALUE, each name once, not '{pair}'")
        found[name] = value
    return found


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
