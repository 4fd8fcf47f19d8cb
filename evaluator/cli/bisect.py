"""gsb-bisect: which release of an engine changed what is recorded."""

from __future__ import annotations

import argparse
import shlex
import signal
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusimbench.evaluator.cli.command import add_json, answer, check_target, complain, entry_point, new_parser
from gpusimbench.schemas.commands.folder_lock import folder_lock
from gpusimbench.schemas.commands.parser import Parser
from gpusimbench.schemas.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from gpusimbench.evaluator.bisect.environment import Plan

_OUT = Path("bisect")
_N_ENV, _STEPS = 4, 500
_RUNS = 5  # of each release, where runs are compared as a set

_EPILOG = """\
gsb-bisect records the good release and the bad one, each in a virtual environment of its own, then the release in the
middle between the last that is like the good one and the first that is not, and so on: of n releases at most
ceil(log2 n) + 2 are recorded. Everything else that a run needs has the same version in all environments, where the
releases take that; "packages" says what changed with the first release that differs.

predicates:
  states       any bit of any state differs from the good release's
  gsb-compare  gsb-compare GOOD OTHER fails: slower, more memory, other physics, invalid, less deterministic; with
               options of its own, such as 'gsb-compare --gate physics'
  COMMAND      is run with two folders of recordings, those of the good release and those of another one; it ends with
               0 where they are alike, with 125 where it cannot tell, with any other code up to 124 where they differ

The recordings lie in --out, a folder for each release: the same command goes on where it was interrupted, and what is
recorded is not recorded again. Environments lie in OUT/environments, each as large as the engine, and can be removed.
A release that cannot be installed or recorded is skipped. Where releases change back and forth, one change is found.

exit codes:
  0  the first release that differs is named
  1  the good or the bad release cannot be installed or recorded, or the predicate fails
  2  wrong usage
  3  a recording is damaged
  5  the bad release does not differ, or releases next to the change could not be judged

files:
  OUT/VERSION/NAME.mcap  a run of that release, a recording like any other
  OUT/environments/VERSION  a virtual environment with that release

see also:
  gsb-diff, which shows where two releases part
  gsb-compare
  docs/bisect.md

examples:
  gsb-bisect --sim mujoco --good 3.2.0 --bad 3.9.0
  gsb-bisect --sim mujoco --good 3.2.0 --bad 3.9.0 --scene franka --predicate 'python judge.py' --out franka
  gsb-bisect --sim mujoco --environment 3.2.0=old/.venv --environment 3.9.0=new/.venv
"""


def parser() -> Parser:
    """The command's arguments."""
    p = new_parser(
        "gsb-bisect",
        "Find the first release of an engine whose recordings differ from those of a good release; few are recorded.",
        _EPILOG,
        reads=(
            "CUDA_VISIBLE_DEVICES",
            "GSB_MADRONA_MODULE",
        ),
    )
    p.add_argument("--sim", required=True, metavar="NAME", help="simulator; see gsb-record --list")
    p.add_argument("--good", metavar="VERSION", help="release to compare with, the oldest")
    p.add_argument("--bad", metavar="VERSION", help="later release, which differs")
    p.add_argument(
        "--predicate", default="states", metavar="NAME",
        help="states, gsb-compare or a COMMAND: in which way releases differ; see --help-all (default: %(default)s)",
    )  # fmt: skip
    p.add_argument("--package", metavar="NAME", help="what pip installs (default: the engine of the simulator)")
    p.add_argument(
        "--environment", action="append", default=[], metavar="VERSION=PATH",
        help="an interpreter or virtual environment that has this release; repeatable, the oldest first: nothing is "
        "installed, and there are no other releases",
    )  # fmt: skip
    p.add_argument("--scene", default="inclined-collision", metavar="NAME", help="(default: %(default)s)")
    p.add_argument("--option", action="append", default=[], metavar="NAME=VALUE", help="of the simulator; repeatable")
    p.add_argument("--n-env", type=int, default=_N_ENV, metavar="N", help="environments (default: %(default)s)")
    p.add_argument(
        "--steps", type=int, default=_STEPS, metavar="N", help="captured steps of each run (default: %(default)s)"
    )
    p.add_argument("--runs", type=int, metavar="R", help=f"of each release (default: 1; of gsb-compare: {_RUNS})")
    p.add_argument("--seed", type=int, default=0, metavar="N", help="of what is drawn (default: %(default)s)")
    p.add_argument(
        "--out", type=Path, default=_OUT, metavar="DIR", help="of recordings and environments (default: %(default)s/)"
    )
    add_json(p, "result")
    p.show_first("--sim", "--good", "--bad", "--predicate", "--environment", "--scene", "--option", "--out", "--json")
    return p


def run(arguments: argparse.Namespace) -> int:
    """Record what is missing, search and print; returns the exit code."""
    from gpusimbench.evaluator.bisect.bisection import Releases, bisect, bisect_document, dump_json, most
    from gpusimbench.evaluator.bisect.environment import between, releases
    from gpusimbench.evaluator.bisect.predicates import predicate_of
    from gpusimbench.evaluator.compute.recorder import about

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # no run goes on that nobody waits for
    given = _environments(arguments)
    _check(arguments, given)
    engine = about(arguments.sim)
    plan = _plan(arguments, engine)
    package = arguments.package or engine.get("distribution") or (arguments.sim if given else "")
    if not package:
        raise UsageError(f"pip has no releases of {arguments.sim}: name what it should install with --package")
    known = tuple(given) or releases(package)
    versions = between(known, arguments.good or known[0], arguments.bad or known[-1])
    say = partial(complain, "gsb-bisect")
    say(f"{len(versions)} releases from {versions[0]} to {versions[-1]}; at most {most(len(versions))} are recorded")
    made = Releases(package, plan, arguments.out, given, say)
    with folder_lock(arguments.out, "gsb-bisect", "bisects releases"):
        found = bisect(made, versions, predicate_of(arguments.predicate), arguments.predicate)
    answer(arguments.json, lambda: dump_json(found), lambda: bisect_document(found))
    return int(ExitCode.OK if found.exact else ExitCode.NOTHING_COMPARABLE)


def _environments(arguments: argparse.Namespace) -> dict[str, Path]:
    found = {}
    for text in arguments.environment:
        version, equals, path = text.partition("=")
        if not equals or not path:
            raise UsageError(f"--environment is VERSION=PATH, not '{text}'")
        if version in found:
            raise UsageError(f"--environment {version} is given twice")
        found[version] = Path(path)
    return found


def _check(arguments: argparse.Namespace, given: dict[str, Path]) -> None:
    from gpusimbench.evaluator.bisect.environment import is_version

    if not given and not (arguments.good and arguments.bad):
        raise UsageError("name the releases with --good and --bad")
    if len(given) == 1:
        raise UsageError("one --environment is nothing to compare: give those of two releases at least")
    for version in filter(None, (*given, arguments.good, arguments.bad, arguments.package)):
        if not is_version(version):
            raise UsageError(f"'{version}' is no version and no package that pip knows")
    for name in ("n_env", "steps", "runs"):
        value = getattr(arguments, name)
        if value is not None and value < 1:
            raise UsageError(f"--{name.replace('_', '-')} is at least 1, not {value}")
    try:
        words = shlex.split(arguments.predicate)
    except ValueError as error:
        raise UsageError(f"--predicate is no command: {error}") from None
    if not words:
        raise UsageError("--predicate is empty")
    check_target(arguments.json)


def _plan(arguments: argparse.Namespace, engine: dict[str, Any]) -> Plan:
    from gpusimbench.evaluator.bisect.environment import Plan, with_options
    from gpusimbench.evaluator.bisect.predicates import compares

    several = compares(arguments.predicate)
    return Plan(
        arguments.sim,
        arguments.scene,
        with_options(tuple(arguments.option), engine.get("across_releases", {})),
        arguments.n_env,
        arguments.steps,
        arguments.seed,
        arguments.runs or (_RUNS if several else 1),
        timed=several,
    )


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
