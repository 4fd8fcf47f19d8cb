"""Starts the process of one run and follows it to its end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from schemas import PARTIAL
from schemas.configuration import RunConfiguration
from schemas.errors import ExitCode

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Result:
    """How a run ended.

    status     complete, failed, invalid; incomplete where the process died without ending its recording
    reason     empty when complete
    path       the recording: under its final name, or its .partial name when incomplete; None when nothing was written
    exit_code  that this run asks the command to end with
    """

    run_index: int
    status: str
    reason: str
    path: Path | None
    exit_code: ExitCode


def launch(
    configuration: RunConfiguration,
    path: Path,
    *,
    run_id: str,
    created: str,
    argv: tuple[str, ...],
    progress: Progress,
) -> Result:
    """Record one run in a fresh process.

    An interruption is passed to the run, which ends its recording, and raised as Interrupted; a second one kills it.
    """
    reader, writer = os.pipe()
    task = {
        "configuration": configuration.to_json(),
        "path": str(path.absolute()),
        "run_id": run_id,
        "created": created,
        "argv": list(argv),
        "report_fd": writer,
    }
    child = subprocess.Popen(
        [sys.executable, "-m", "recorder.child"],
        stdin=subprocess.PIPE,
        pass_fds=(writer,),
        env=_environment(),
        start_new_session=True,  # interruptions reach the run once, through this process
    )
    os.close(writer)
    last: dict[str, Any] = {}
    interrupted = False
    with os.fdopen(reader) as reports:
        while True:
            try:
                if child.stdin and not child.stdin.closed:
                    with suppress(BrokenPipeError):
                        child.stdin.write(json.dumps(task).encode())
                        child.stdin.close()
                for line in reports:
                    record = json.loads(line)
                    if "phase" in record:
                        progress(record["phase"], record["done"], record["of"])
                    else:
                        last = record
                child.wait()
                break
            except KeyboardInterrupt:
                if interrupted:
                    child.kill()
                else:
                    interrupted = True
                    child.send_signal(signal.SIGINT)
    result = _result(configuration.run_index, path, child.returncode, last)
    if interrupted:
        raise Interrupted(result)
    return result


class Interrupted(KeyboardInterrupt):
    """The user's interruption, with the result of the run that it ended."""

    def __init__(self, result: Result) -> None:
        super().__init__()
        self.result = result


def _environment() -> dict[str, str]:
    # the child imports the same packages, also from a checkout that is not installed
    root = str(Path(__file__).resolve().parent.parent)
    given = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    paths = [root, *map(os.path.abspath, given)]  # the run works in a folder of its own
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}


def _result(run_index: int, path: Path, returncode: int, last: dict[str, Any]) -> Result:
    if "status" in last:
        code = ExitCode.OK if last["status"] == "complete" else ExitCode.FAILURE
        return Result(run_index, last["status"], last["reason"], path, code)
    partial = path.with_name(path.name + PARTIAL)
    left = partial if partial.exists() else None
    if "error" in last:
        return Result(run_index, "incomplete", last["error"], left, ExitCode(last["exit_code"]))
    if returncode < 0:
        try:
            how = f"was killed by {signal.Signals(-returncode).name}"
        except ValueError:
            how = f"was killed by signal {-returncode}"
    else:
        how = f"ended with exit code {returncode}"
    where = f"; what it had written is in {left}" if left else "; it had written nothing"
    return Result(run_index, "incomplete", f"the run's process {how}{where}", left, ExitCode.DATA_LOST)
