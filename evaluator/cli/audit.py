"""gsb-audit: is a recording whole, and does the same come out when its run is made again, here?"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import (
    add_json,
    check_target,
    complain,
    entry_point,
    local_path,
    new_parser,
    say,
    write_json,
)
from gpusimbench.schemas import text
from gpusimbench.schemas.errors import ExitCode, UsageError
from gpusimbench.schemas.text import line, show

if TYPE_CHECKING:
    from gpusimbench.evaluator.audit.audit import Audit
    from gpusimbench.evaluator.audit.verdict import AuditLevel

_LEVELS = ("bit-identical", "same-up-to-env-order", "within-ulps", "same-distribution")

_MOST_RUNS = 1000

_EPILOG = """\
A replay takes only the configuration from a file: no code, no model, no path. The file must contain evidence for as
many steps and environments as it asks for, and what will run is printed first. Because options can ask for any amount
of work, a replay ends after 20 times the time of the original (at least ten minutes, at most a day), or after
--timeout. It is stopped if it takes more than twice the recorded memory (at least 2 GiB, at most 80 % of this
machine's), starts too many threads, or writes more than twice what the original holds; see docs/audit.md.

levels (strongest first):
  bit-identical         every recorded number of every replay has the same bits as in an original, at every step
  same-up-to-env-order  the same, but environments are in another order
  within-ulps           no two numbers are further apart than --ulps units in the last place
  same-distribution     a permutation test on the cubes' planar positions finds no difference between originals and
                        replays, and there are enough of them to find one
  different             none of these

exit codes:
  0  every verdict is at least the level of --require
  1  a replay failed while others did not
  2  wrong usage
  3  a file is damaged, cut short or not a recording; the others were audited
  4  a verdict is below the level of --require, or a rule of integrity-1 (see gsb-check) is broken
  5  a run cannot be replayed here (the message says what is missing), was refused or stopped because it would take
     too much memory, time or disk, or the replays are too few to decide

files:
  OUT/NAME.mcap  a replay, a recording like any other

see also:
  gsb-record --replay, which only replays
  gsb-diff, which shows where two recordings first differ
  docs/audit.md

examples:
  gsb-audit theirs.mcap
  gsb-audit theirs/*.mcap --runs 6 --require bit-identical --json audit.json
  gsb-audit theirs.mcap --option device=cpu
  gsb-audit train.mcap --command 'python train.py --seed {seed}'
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-audit",
        "Check recordings, run their configurations again on this machine (replays), and say how closely the results "
        "agree. Recordings of the same configuration are audited together.",
        _EPILOG,
        reads=(
            "CUDA_VISIBLE_DEVICES",
            "GSB_ENVIRONMENTS",
            "GSB_MADRONA_MODULE",
        ),
    )
    p.add_argument("files", nargs="+", type=local_path, metavar="FILE", help="recordings (.mcap), or folders of them")
    p.add_argument(
        "--runs",
        type=int,
        default=1,
        metavar="R",
        help="replays of each configuration (default: 1; the test of distributions needs up to 19)",
    )
    p.add_argument(
        "--out", type=local_path, default=Path("audit"), metavar="DIR", help="folder of the replays (default: audit/)"
    )
    p.add_argument(
        "--require",
        choices=_LEVELS,
        metavar="LEVEL",
        help="weakest level that ends with exit code 0; see --help-all for the levels (default: same-distribution; "
        "bit-identical with --command)",
    )
    p.add_argument(
        "--ulps",
        type=int,
        default=4,
        metavar="K",
        help="largest distance of the level within-ulps (default: %(default)s)",
    )
    add_json(p, "results")
    p.add_argument("--all", action="store_true", help="print all replays, levels, notes and values of settings")
    p.add_argument("--python", type=local_path, metavar="PATH", help="Python interpreter that runs the replays")
    p.add_argument(
        "--timeout",
        type=float,
        metavar="S",
        help="time limit of each replay [s]; 0: none (default: 20 times the original, none with --command)",
    )
    p.add_argument(
        "--command",
        metavar="PROGRAM",
        help="the program that made the recording, with its arguments, as one quoted argument; it is run again "
        "instead of a simulator of gsb-record, and {seed} stands for the recorded seed",
    )
    p.add_argument(
        "--allow-model",
        action="store_true",
        help="replay recordings that carry a model file of their author's, which the engine's parser then reads",
    )
    p.add_argument(
        "--phases", metavar="LIST", help="phases to replay: timed, capture or both (default: those that were recorded)"
    )
    p.add_argument(
        "--option", action="append", default=[], metavar="NAME=VALUE", help="replace a recorded option; repeatable"
    )
    p.show_first(
        "--runs", "--out", "--require", "--json", "--all", "--command", "--python", "--timeout", "--allow-model",
        "--phases", "--option",
    )  # fmt: skip
    return p


def run(arguments: argparse.Namespace) -> int:
    """Audit and print; returns the exit code."""
    from gpusimbench.evaluator.audit.audit import audit, check_files
    from gpusimbench.evaluator.audit.replays import ReplayPlan
    from gpusimbench.evaluator.audit.sections import audit_document, dump_json
    from gpusimbench.evaluator.audit.verdict import AuditLevel
    from gpusimbench.evaluator.read.addresses import expand_paths
    from gpusimbench.evaluator.render.terminal import print_document
    from gpusimbench.evaluator.runs.groups import group

    _check(arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # no replay goes on that nobody waits for
    plan = ReplayPlan(
        arguments.out,
        arguments.runs,
        arguments.python,
        arguments.timeout,
        tuple(arguments.option),
        arguments.phases,
        arguments.allow_model,
        arguments.command,
    )
    required = AuditLevel(arguments.require or (_LEVELS[-1] if arguments.command is None else _LEVELS[0]))
    checked = check_files(expand_paths(arguments.files))
    for path, findings in checked.damaged.items():
        complain("gsb-audit", f"{path} is not audited: {'; '.join(findings)}")
    audits = []
    for alike in group(checked.recordings):
        audits.append(audit(alike, plan, max_ulps=arguments.ulps, say=say))
        if arguments.json != "-":
            with text.live:
                print_document(audit_document(audits[-1], checked, every=arguments.all), sys.stdout)
            show(line(""))
    if arguments.json:
        write_json(arguments.json, dump_json(audits, checked, required))
    if checked.damaged:
        return int(ExitCode.DATA_LOST)
    return int(ExitCode.GATE_FAILED if checked.broken else _exit_code(audits, required))


def _check(arguments: argparse.Namespace) -> None:
    if not 1 <= arguments.runs <= _MOST_RUNS:
        raise UsageError(f"--runs must be from 1 to {_MOST_RUNS}, not {arguments.runs}")
    if arguments.ulps < 0:
        raise UsageError(f"--ulps must be at least 0, not {arguments.ulps}")
    if arguments.command is not None and (
        arguments.python or arguments.option or arguments.phases or arguments.allow_model
    ):
        raise UsageError("--command runs the program as it is: no --python, --option, --phases or --allow-model")
    if arguments.timeout is not None and not 0 <= arguments.timeout < float("inf"):
        raise UsageError(f"--timeout is a number of seconds, 0 for never, not {arguments.timeout}")
    check_target(arguments.json)


def _exit_code(audits: list[Audit], required: AuditLevel) -> ExitCode:
    met = [audit.meets(required) for audit in audits]
    if False in met:
        return ExitCode.GATE_FAILED
    if any(audit.failed and audit.recordings for audit in audits):
        return ExitCode.FAILURE
    return ExitCode.NOTHING_COMPARABLE if None in met else ExitCode.OK


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
