"""gsb-run: does a program do the same again, and if not, what differs first?"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from gpusimbench.evaluator.cli.command import add_json, answer, check_target, entry_point, local_path, new_parser, say
from gpusimbench.schemas.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from gpusimbench.evaluator.programs import Comparison

_MOST_RUNS = 1000

_EPILOG = """\
The program runs R times, one run after another, each in a process of its own with the environment variable GSB_RUN,
which names the folder of the run: OUT/run-0, OUT/run-1, ... There, gpusimbench.wrap and RecordingWriter put recordings
whose path is relative. What the program prints is in output.txt. Processes that the program leaves running are killed;
on Linux also those that started a session of their own.

The recordings of all runs are compared with those of the first. If the program hashes its policy, gradients or batches
(log.fingerprint), the verdict says whether one of them, the actions or the simulator differed first.

exit codes:
  0  all runs wrote the same recordings, bit for bit
  1  a run failed or took longer than --time-limit; those that ended do not differ
  2  wrong usage, or the program cannot be started
  3  a file of a run is damaged, or is named like a recording but is none; what was compared does not differ
  4  runs differ
  5  there is nothing to compare, or not all of it: a recording that one run lacks or did not end

files:
  OUT/run-K/  a run: recordings that the program wrote, and output.txt, what it printed
  OUT/run-K/program.json  the command, and digests of the files that it names

see also:
  gsb-diff, which compares two recordings
  gsb-audit --command, which runs a program again
  docs/how-to/is-my-training-reproducible.md
  docs/how-to/record-your-task.md

examples:
  gsb-run -- python train.py --seed 3
  gsb-run --json - -- python train.py --seed 3 | jq .verdict
  gsb-run --runs 3 --time-limit 600 --out seed-3 -- python train.py --seed 3
"""


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = new_parser(
        "gsb-run",
        "Run a program several times, and say whether the runs are the same bit for bit, or which of simulator, "
        "actions, policy, gradient and batch differs first.",
        _EPILOG,
        reads=("CUDA_VISIBLE_DEVICES",),
    )
    p.add_argument(
        "program", nargs=argparse.PARSER, metavar="PROGRAM", help="the program, and behind it all that it is given"
    )
    p.add_argument("--runs", type=int, default=2, metavar="R", help="how many runs (default: %(default)s)")
    p.add_argument(
        "--out", type=local_path, default=Path("program-runs"), metavar="DIR",
        help="folder of the runs; further runs get further numbers (default: program-runs/)",
    )  # fmt: skip
    p.add_argument(
        "--time-limit", type=float, default=0.0, metavar="S",
        help="interrupt a run after so many seconds; 0: never (default: 0)",
    )  # fmt: skip
    add_json(p, "results")
    return p


def run(arguments: argparse.Namespace) -> int:
    """Run the program, compare and print; returns the exit code."""
    from gpusimbench.evaluator.compute.recorder import run_program
    from gpusimbench.evaluator.programs import compare_runs, dump_json, runs_document

    program = arguments.program[1:] if arguments.program[0] == "--" else arguments.program
    if not program or not program[0]:
        raise UsageError("no program is named: give it behind the options, such as gsb-run -- python train.py")
    if not 2 <= arguments.runs <= _MOST_RUNS:
        raise UsageError(f"--runs must be from 2 to {_MOST_RUNS}, not {arguments.runs}")
    if not 0 <= arguments.time_limit < float("inf"):
        raise UsageError(f"--time-limit is a number of seconds, 0 for never, not {arguments.time_limit}")
    check_target(arguments.json)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # no run goes on that nobody waits for
    runs = run_program(program, arguments.runs, arguments.out, arguments.time_limit, say)
    found = compare_runs(program, runs)
    answer(arguments.json, lambda: dump_json(found), lambda: runs_document(found))
    return int(_exit_code(found))


def _exit_code(found: Comparison) -> ExitCode:
    if any(one.difference and one.difference.different for one in found.compared):
        return ExitCode.GATE_FAILED
    if found.damaged:
        return ExitCode.DATA_LOST
    if found.failed:
        return ExitCode.FAILURE
    return ExitCode.OK if found.whole and found.verdict is not None else ExitCode.NOTHING_COMPARABLE


main = entry_point(parser, run)


if __name__ == "__main__":
    sys.exit(main())
