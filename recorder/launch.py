"""Starts the process of one run and follows it to its end."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from recorder.interruption import SIGNALS, blocked
from recorder.plan import release
from schemas.configuration import RunConfiguration
from schemas.errors import ExitCode, GsbError

Progress = Callable[[str, int, int], None]

_SAID_BYTES = 4096  # of the end of what a run's process printed
_SAID_CHARACTERS = 300


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


class Interruptions:
    """Counts the user's interruptions, and passes them on to the process of the present run.

    The first lets it end its recording, the second kills it. Nothing is raised, so a set of runs is interrupted only
    where it looks. A context manager.

    count  interruptions so far
    """

    def __init__(self) -> None:
        self.count = 0
        self._child: subprocess.Popen[bytes] | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruptions:
        self._before = {number: signal.getsignal(number) for number in SIGNALS}
        for number, handler in self._before.items():
            if handler is not signal.SIG_IGN:  # as a shell starts background jobs
                signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def follow(self, child: subprocess.Popen[bytes] | None) -> None:
        """Pass interruptions on to this process, also those that came before; None: to none."""
        self._child = child
        self._pass_on()

    def _handle(self, number: int, frame: object) -> None:
        self.count += 1
        self._pass_on()

    def _pass_on(self) -> None:
        if self._child is None or not self.count:
            return
        if self.count > 1:
            self._child.kill()
        else:
            self._child.send_signal(signal.SIGINT)  # the run heeds only the first of these


def launch(
    configuration: RunConfiguration,
    path: Path,
    *,
    run_id: str,
    created: str,
    argv: tuple[str, ...],
    progress: Progress,
    interruptions: Interruptions,
) -> Result:
    """Record one run in a fresh process, into `path`, whose name is reserved (recorder.plan.reserve).

    GsbError where no process can be started.
    """
    scratch = Path(tempfile.mkdtemp(prefix="gsb-run-"))
    task = {
        "configuration": configuration.to_json(),
        "path": str(path.absolute()),
        "run_id": run_id,
        "created": created,
        "argv": list(argv),
        "scratch": str(scratch),
    }
    try:
        returncode, last = _follow(task, scratch / "output", progress, interruptions)
        said = "" if last else _last_line(scratch / "output")
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
        left = release(path)
    return _result(configuration.run_index, path, left, returncode, last, said, interrupted=interruptions.count > 0)


def _follow(
    task: dict[str, Any], output: Path, progress: Progress, interruptions: Interruptions
) -> tuple[int, dict[str, Any]]:
    # exit code of the run's process, and its last word: how the run ended; empty when it died without one
    reader, writer = os.pipe()
    last: dict[str, Any] = {}
    with os.fdopen(reader) as reports, tempfile.TemporaryFile() as given, output.open("wb") as printed:
        given.write(json.dumps(task).encode())
        given.seek(0)
        try:
            with blocked():  # until the run can end its recording, an interruption waits
                child = subprocess.Popen(
                    [sys.executable, "-m", "recorder.child", str(writer)],
                    stdin=given,
                    stdout=printed,
                    stderr=printed,
                    pass_fds=(writer,),
                    env=_environment(),
                    start_new_session=True,  # interruptions reach the run once, through this process
                )
        except OSError as error:
            raise GsbError(f"cannot start the run's process: {error.strerror}") from None
        finally:
            os.close(writer)
        interruptions.follow(child)
        try:
            for line in reports:
                with suppress(ValueError):  # a line that a killed process did not finish
                    record = json.loads(line)
                    if "phase" in record:
                        progress(record["phase"], record["done"], record["of"])
                    else:
                        last = record
        except BaseException:
            child.send_signal(signal.SIGINT)  # no run goes on that nobody follows
            raise
        finally:
            child.wait()
            interruptions.follow(None)
    return child.returncode, last


def _last_line(output: Path) -> str:
    try:
        with output.open("rb") as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - _SAID_BYTES))
            lines = stream.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    printable = ("".join(c for c in line if c.isprintable()).strip() for line in lines)
    return next((line[:_SAID_CHARACTERS] for line in reversed(list(printable)) if line), "")


def _environment() -> dict[str, str]:
    # the child imports the same packages, also from a checkout that is not installed
    root = str(Path(__file__).resolve().parent.parent)
    given = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    paths = [root, *map(os.path.abspath, given)]  # the run works in a folder of its own
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}


def _result(
    run_index: int,
    path: Path,
    left: Path | None,
    returncode: int,
    last: dict[str, Any],
    said: str,
    *,
    interrupted: bool,
) -> Result:
    if "status" in last:
        code = ExitCode.OK if last["status"] == "complete" else ExitCode.FAILURE
        return Result(run_index, last["status"], last["reason"], path, code)
    if "error" in last:
        return Result(run_index, "incomplete", last["error"], left, ExitCode(last["exit_code"]))
    if interrupted and left is None:
        return Result(run_index, "incomplete", "interrupted before anything was written", None, ExitCode.FAILURE)
    if returncode < 0:
        try:
            how = f"was killed by {signal.Signals(-returncode).name}"
        except ValueError:
            how = f"was killed by signal {-returncode}"
    else:
        how = f"ended with exit code {returncode}"
    where = f"; what it had written is in {left}" if left else "; it had written nothing"
    words = f"; the last that it printed: {said}" if said else ""
    return Result(run_index, "incomplete", f"the run's process {how}{where}{words}", left, ExitCode.DATA_LOST)
