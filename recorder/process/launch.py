"""Makes a run: starts its process and follows it to its end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from io import FileIO
from pathlib import Path
from typing import Any, TextIO

from gpusimbench.recorder.environments.interpreter import Interpreter
from gpusimbench.recorder.interruption import ENDING, MARK, SIGNALS, blocked
from gpusimbench.recorder.plan import partial_of, release, reserve
from gpusimbench.recorder.process.cage import Guard
from gpusimbench.recorder.process.planned_run import PlannedRun
from gpusimbench.recorder.run.pace import BETWEEN, Report
from gpusimbench.schemas.configuration import RunConfiguration
from gpusimbench.schemas.errors import ExitCode, GsbError
from gpusimbench.schemas.scratch import OUTPUT, making, scratch_folder
from gpusimbench.schemas.writing import create, write_file

GRACE_S = 30.0
"""How long a run that has timed out may take to bring its recording to an end [s]. An engine that sits in native code,
such as a compilation, never lets it begin with that, and is killed."""

_SAID_BYTES = 4096  # of the end of what a run's process printed
_SAID_CHARACTERS = 300
_OWN_RISK = "Where you trust the file, make the run as your own: gsb-record --sim has no such bounds"


@dataclass(frozen=True)
class Result:
    """How a run ended.

    status     complete, failed, invalid; incomplete where the process died without ending its recording; stopped where
               it took more than a replay may
    reason     empty when complete
    path       the recording: under its final name, or its .partial name when incomplete; None when nothing was written
    exit_code  that this run asks the command to end with
    cause      a name of gsb.v1.Cause; empty when complete, or when nothing is known
    died       the process ended without saying why
    """

    run_index: int
    status: str
    reason: str
    path: Path | None
    exit_code: ExitCode
    cause: str = ""
    died: bool = False


class Interruptions:
    """Counts the user's interruptions, and passes them on to the process of the present run.

    The first lets it end its recording, the second kills it. Nothing is raised, so a set of runs is interrupted only
    where it looks. A context manager.

    count  interruptions so far
    """

    def __init__(self) -> None:
        self.count = 0
        self._child: subprocess.Popen[bytes] | None = None
        self._mark: Path | None = None
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interruptions:
        self._before = {number: signal.getsignal(number) for number in SIGNALS}
        for number, handler in self._before.items():
            if handler is not signal.SIG_IGN:  # as a shell starts background jobs
                signal.signal(number, self._handle)
        return self

    def __exit__(self, *details: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def follow(self, child: subprocess.Popen[bytes] | None, mark: Path | None = None) -> None:
        """Pass interruptions on to this process, also those that came before; None: to none.

        mark  a file that is made before the process gets its signal
        """
        self._child, self._mark = child, mark
        self._pass_on()

    def add(self) -> None:
        """One more, by whatever way the user's wish came."""
        self.count += 1
        self._pass_on()

    def _handle(self, number: int, frame: object) -> None:
        self.add()

    def _pass_on(self) -> None:
        child, mark = self._child, self._mark  # of which another thread may say meanwhile that there is none any more
        if child is None or not self.count:
            return
        if self.count > 1:
            child.kill()
        else:
            if mark is not None:
                with suppress(OSError):
                    create(mark).close()
            child.send_signal(signal.SIGINT)  # the run heeds only the first of these


def make(
    planned: PlannedRun, folder: Path, interpreter: Interpreter, progress: Report, interruptions: Interruptions
) -> Result:
    """Make the run in a fresh process of `interpreter`, its recording in `folder`.

    A run with a time limit that neither ends nor begins to end its recording within GRACE_S more is killed. So is one
    that passes a bound of its cage; nothing is left of that.

    GsbError where no process can be started, or there is no room for temporary files.
    """
    path = reserve(folder, planned.configuration, planned.provenance.created_utc)
    result = _launch(planned, path, interpreter, progress, interruptions)
    if not (planned.end_killed and result.died and result.cause == "TIMEOUT") or interruptions.count:
        return result

    from gpusimbench.recorder.process.killed import record_killed

    path = record_killed(folder, planned.provenance, result.path, interpreter, result.reason)
    return replace(result, status="failed", path=path, exit_code=ExitCode.FAILURE)


def _launch(
    planned: PlannedRun, path: Path, interpreter: Interpreter, progress: Report, interruptions: Interruptions
) -> Result:
    configuration = planned.configuration
    try:
        with scratch_folder() as (scratch, printed):
            task = {
                "provenance": planned.provenance.to_json(),
                "path": str(path.absolute()),
                "scratch": str(scratch),
                "inputs": _write_inputs(scratch, planned.inputs),
            }
            with _started(task, scratch, printed, interpreter) as (child, reports):
                interruptions.follow(child, scratch / MARK)
                end = _follow(child, reports, planned, (partial_of(path.absolute()), scratch), progress, interruptions)
            said = "" if end.last else last_line(scratch / OUTPUT)
    finally:
        left = release(path)
    if end.stopped and left:
        left.unlink(missing_ok=True)
    return _result(configuration, path, left, end, said, interrupted=interruptions.count > 0)


def _write_inputs(scratch: Path, inputs: Mapping[str, bytes]) -> str | None:
    # in a folder of their own: the files of the scratch folder are the engine's log
    if not inputs:
        return None
    folder = scratch / "inputs"
    folder.mkdir()
    for name, data in inputs.items():
        write_file(folder / name, data, durable=False)
    return str(folder)


@dataclass
class _End:
    """How a run's process ended.

    returncode  as of subprocess.Popen
    last        its last word: how the run ended; empty when it died without one
    phase       the last that it reported
    overdue     it was killed for taking too long
    late        its time limit was over before it ended
    stopped     the bound of its cage that it passed, and was killed for; empty where it passed none
    """

    returncode: int = 0
    last: dict[str, Any] = field(default_factory=dict)
    phase: str = "start"
    overdue: bool = False
    late: bool = False
    stopped: str = ""


class _Deadline:
    """Kills a process, and what it started, once a time is over. A context manager: outside of it, nothing is killed.

    passed  whether it did
    """

    def __init__(self, child: subprocess.Popen[bytes]) -> None:
        self.passed = False
        self._child = child
        self._timer: threading.Timer | None = None

    def set(self, seconds: float) -> None:
        """So many seconds from now, instead of what was set before."""
        self.clear()
        self._timer = threading.Timer(seconds, self._kill)
        self._timer.daemon = True
        self._timer.start()

    def clear(self) -> None:
        """Never."""
        if self._timer is not None:
            self._timer.cancel()

    def __enter__(self) -> _Deadline:
        return self

    def __exit__(self, *details: object) -> None:
        self.clear()

    def _kill(self) -> None:
        # The process leads a session of its own. A compiler that it started would hold its pipe open, and outlive it.
        self.passed = True
        with suppress(ProcessLookupError):
            os.killpg(self._child.pid, signal.SIGKILL)


@contextmanager
def _started(
    task: dict[str, Any], scratch: Path, printed: FileIO, interpreter: Interpreter
) -> Iterator[tuple[subprocess.Popen[bytes], TextIO]]:
    """The run's process, and what it reports, a line each."""
    environment = interpreter.environment(scratch)
    with making():
        given = tempfile.TemporaryFile()  # noqa: SIM115 (closed below, and where writing fails)
        given.write(json.dumps(task).encode())
        given.seek(0)
    reader, writer = os.pipe()
    with os.fdopen(reader) as reports, given:
        try:
            with blocked():  # until the run can end its recording, an interruption waits
                child = subprocess.Popen(
                    interpreter.command("-m", "gpusimbench.recorder.process.child", str(writer)),
                    stdin=given,
                    stdout=printed,
                    stderr=printed,
                    pass_fds=(writer,),
                    env=environment,
                    start_new_session=True,  # interruptions reach the run once, through this process
                )
        except OSError as error:
            raise GsbError(f"cannot start the run's process: {error.strerror}") from None
        finally:
            os.close(writer)
        yield child, reports


def _follow(
    child: subprocess.Popen[bytes], reports: Iterable[str], planned: PlannedRun, written: Iterable[Path],
    progress: Report, interruptions: Interruptions,
) -> _End:  # fmt: skip
    # written: files and folders whose size counts
    end, begun, timeout = _End(), time.monotonic(), planned.configuration.timeout
    guarded = nullcontext() if planned.cage is None else Guard(child, planned.cage, written)
    with _Deadline(child) as deadline, guarded as guard:
        if timeout:
            deadline.set(timeout + GRACE_S)
        try:
            for line in reports:
                with suppress(ValueError):  # a line that a killed process did not finish
                    _hear(json.loads(line), end, timeout, deadline, progress)
        except BaseException:
            child.send_signal(signal.SIGINT)  # no run goes on that nobody follows
            raise
        finally:
            end.returncode = child.wait()
            interruptions.follow(None)
    end.overdue = deadline.passed
    end.stopped = "" if guard is None else guard.broken
    end.late = 0 < timeout <= time.monotonic() - begun
    return end


def _hear(record: dict[str, Any], end: _End, timeout: float, deadline: _Deadline, progress: Report) -> None:
    if "phase" not in record:
        end.last = record
        if timeout:
            deadline.set(GRACE_S)  # an engine can hang in what it does at the process's exit, too
        return
    if record["phase"] not in BETWEEN:
        end.phase = record["phase"]
    if end.phase == ENDING:
        deadline.clear()  # what is left to do is writing, and a slow disk is no reason to lose it
    progress(record["phase"], record["done"], record["of"])


def last_line(output: Path) -> str:
    """The last line with anything printable in a file of what a process printed; empty where there is none."""
    try:
        with output.open("rb") as stream:
            stream.seek(max(0, stream.seek(0, os.SEEK_END) - _SAID_BYTES))
            lines = stream.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    printable = ("".join(c for c in line if c.isprintable()).strip() for line in lines)
    return next((line[:_SAID_CHARACTERS] for line in reversed(list(printable)) if line), "")


def _result(
    configuration: RunConfiguration, path: Path, left: Path | None, end: _End, said: str, *, interrupted: bool
) -> Result:
    index, last = configuration.run_index, end.last
    if "status" in last:
        code = ExitCode.OK if last["status"] == "complete" else ExitCode.FAILURE
        return Result(index, last["status"], last["reason"], path, code, last["cause"])
    if end.stopped:
        reason = f"{end.stopped}; nothing of it is kept. {_OWN_RISK}"
        return Result(index, "stopped", reason, None, ExitCode.FAILURE)
    # whatever an engine made of an interruption or of the end of its time: a failed import, an abort
    cause = "INTERRUPTED" if interrupted else "TIMEOUT" if end.late else ""
    if "error" in last:
        return Result(index, "incomplete", last["error"], left, ExitCode(last["exit_code"]), cause)
    if interrupted and left is None:
        return Result(index, "incomplete", "interrupted before anything was written", None, ExitCode.FAILURE, cause)
    where = f"; what it had written is in {left}" if left else "; it had written nothing"
    words = f"; the last that it printed: {said}" if said else ""
    how = how_it_died(end.returncode)
    if end.overdue and end.returncode == -signal.SIGKILL:
        how = f"did not end {GRACE_S:g} s after its timeout of {configuration.timeout:g} s and was killed in phase "
        how += end.phase
    elif cause == "TIMEOUT":
        how += f" after its timeout of {configuration.timeout:g} s, in phase {end.phase}"
    reason = f"the run's process {how}{where}{words}"
    return Result(index, "incomplete", reason, left, ExitCode.DATA_LOST, cause, died=True)


def how_it_died(returncode: int) -> str:
    """What a return code of subprocess.Popen says, in words."""
    if returncode >= 0:
        return f"ended with exit code {returncode}"
    try:
        return f"was killed by {signal.Signals(-returncode).name}"
    except ValueError:
        return f"was killed by signal {-returncode}"
