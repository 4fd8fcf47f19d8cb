"""``python -m gpusimbench.recorder.conformance --sim NAME``: all checks of one adapter, a line each."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path

from gpusimbench.recorder.conformance import CHECKS, Check, NotApplicable, Subject
from gpusimbench.recorder.environments.choice import interpreter_for
from gpusimbench.recorder.environments.interpreter import Interpreter
from gpusimbench.recorder.options import split_options
from gpusimbench.recorder.sets.progress import say
from gpusimbench.recorder.simulators.registry import find_simulator
from gpusimbench.schemas.commands import SCHEMA_VERSION
from gpusimbench.schemas.commands.output import leavable, let_readers_leave, show, show_document
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError
from gpusimbench.schemas.scratch import scratch_folder
from gpusimbench.schemas.text import line

_EPILOG = """\
exit codes:
  0  no check failed
  1  a check failed
  2  wrong usage, such as an option that the simulator does not have

examples:
  python -m gpusimbench.recorder.conformance --sim mujoco
  python -m gpusimbench.recorder.conformance --sim mujoco --option cone=pyramidal --json
"""

_INSIDE = "GSB_CONFORMANCE_INSIDE"  # set where another Python was chosen already

OK, FAILED, SKIPPED = "ok", "failed", "skipped"


@dataclass(frozen=True)
class CheckResult:
    """What one check found.

    outcome  ok, failed or skipped
    reason   why not; empty where ok
    seconds  that the check took, builds that it was the first to need included
    """

    check: str
    outcome: str
    reason: str
    seconds: float

    def line(self) -> str:
        """For people."""
        if self.outcome == OK:
            return f"{OK:<7} {self.check}"
        return f"{self.outcome.upper() if self.outcome == FAILED else self.outcome:<7} {self.check}: {self.reason}"


def judge(check: Check, subject: Subject) -> CheckResult:
    """Make one check. UsageError where the adapter does not take the conformance scene or its options."""
    began = time.perf_counter()
    outcome, why = OK, ""
    try:
        with redirect_stdout(sys.stderr):  # what engines print is no result
            check(subject)
    except NotApplicable as reason:
        outcome, why = SKIPPED, str(reason)
    except AssertionError as error:
        outcome, why = FAILED, str(error) or "an assertion failed"
    except UsageError:
        raise
    except Exception as error:
        outcome, why = FAILED, f"{type(error).__name__}: {error}"
    return CheckResult(check.__name__, outcome, " ".join(why.split()), round(time.perf_counter() - began, 3))


def parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    p = argparse.ArgumentParser(
        prog="python -m gpusimbench.recorder.conformance",
        description="Check a simulator's adapter against the contract, formulas and itself.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    p.add_argument("--sim", required=True, metavar="NAME", help="simulator, as gsb-record --list shows it")
    p.add_argument("--option", action="append", default=[], metavar="NAME=VALUE", help="of the simulator; repeatable")
    p.add_argument("--determinism", default="default", metavar="LEVEL", help="of the simulator (default: %(default)s)")
    p.add_argument("--python", type=Path, metavar="PATH", help="interpreter that has the engine (default: found)")
    p.add_argument("--json", action="store_true", help="print the results as JSON on standard output, at the end")
    return p


def run(given: list[str]) -> int:
    """Do what the arguments say; returns the exit code. Errors as of schemas.errors."""
    arguments = parser().parse_args(given)
    if _INSIDE not in os.environ:
        interpreter = interpreter_for(find_simulator(arguments.sim), arguments.python)
        if not interpreter.own:
            return _elsewhere(interpreter, given)
    subject = Subject.named(arguments.sim, split_options(arguments.option), arguments.determinism)
    verdicts = []
    for check in CHECKS:
        verdict = judge(check, subject)
        verdicts.append(verdict)
        if not arguments.json:
            show(line(verdict.line()))
    tally = {outcome: sum(v.outcome == outcome for v in verdicts) for outcome in (OK, FAILED, SKIPPED)}
    if arguments.json:
        what = {"simulator": arguments.sim, "options": subject.given, "determinism": arguments.determinism}
        record = {"schema_version": SCHEMA_VERSION, **what, "checks": [asdict(verdict) for verdict in verdicts]}
        show_document(json.dumps(record, indent=1))
    else:
        show(line(f"{subject.name}: " + ", ".join(f"{count} {outcome}" for outcome, count in tally.items())))
    return int(ExitCode.FAILURE if tally[FAILED] else ExitCode.OK)


def _elsewhere(interpreter: Interpreter, given: list[str]) -> int:
    with scratch_folder() as (folder, lock):
        command = interpreter.command("-m", "gpusimbench.recorder.conformance", *given)
        environment = {**interpreter.environment(folder), _INSIDE: "1"}
        code = subprocess.run(command, stdout=sys.stdout, env=environment, pass_fds=(lock.fileno(),)).returncode
    return code if code >= 0 else int(ExitCode.FAILURE)


def _take_standard_output() -> None:
    # Engines print below Python's streams, too: results keep the real standard output, all else goes where errors go.
    let_readers_leave()
    sys.stdout.flush()
    sys.stdout = leavable(sys.stdout, os.dup(1))
    os.dup2(2, 1)


def main() -> int:
    """Entry point."""
    try:
        _take_standard_output()
        return run(sys.argv[1:])
    except GsbError as error:
        say(f"gpusimbench.recorder.conformance: {error}")
        return int(error.exit_code)
    except KeyboardInterrupt:
        say("gpusimbench.recorder.conformance: interrupted")
        return int(ExitCode.FAILURE)


if __name__ == "__main__":
    sys.exit(main())
