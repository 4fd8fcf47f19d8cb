"""gsb-record in a process of its own: reading recordings needs no simulator, running them does."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from gpusimbench.schemas.commands.parent import signalled_at_its_end
from gpusimbench.schemas.errors import ExitCode, GsbError, UsageError

COMMAND = "gsb-record"
PROGRAMS = "gsb-run"
_KEPT_LINES = 50
_MOST_BYTES = 16 << 20  # of what it prints on standard output


@dataclass(frozen=True)
class Made:
    """One run: how it ended, and its recording; None where nothing was written."""

    status: str
    reason: str
    file: Path | None


def record(arguments: Sequence[str], say: Callable[[str], None]) -> tuple[tuple[Made, ...], str]:
    """Run gsb-record and wait for its end: the runs that were begun, and why none was.

    say  gets what it says on the way, line by line, without the refusal that is returned

    GsbError where it cannot be started or does not say what it did. An interruption is passed on to it, and raised
    again once it has ended.
    """
    held: list[str] = []  # complaints that may be the last words

    def hold(told: str) -> None:
        held.append(told)
        if not told.startswith(f"{COMMAND}: "):
            release()

    def release() -> None:
        while held:
            say(held.pop(0))

    try:
        returncode, output, said = _run_cli(["gpusimbench.recorder.cli", *arguments, "--json"], hold)
    except KeyboardInterrupt:
        release()
        raise
    if returncode == ExitCode.USAGE and not output:
        return (), _refusal(said)
    release()
    return _parse_runs(output, returncode, said), ""


def about(simulator: str) -> dict[str, Any]:
    """What ``gsb-record --list NAME --json`` says of a simulator; UsageError where there is none of that name."""
    returncode, output, said = _run_cli(["gpusimbench.recorder.cli", "--list", simulator, "--json"], lambda text: None)
    try:
        found: dict[str, Any] = json.loads(output)["simulator"]
        return found
    except (ValueError, LookupError):
        raise UsageError(_refusal(said) if returncode else f"'{simulator}' is no simulator") from None


@dataclass(frozen=True)
class ProgramRun:
    """One run of a user's program, as recorder.programs.run has it."""

    folder: Path
    status: str
    reason: str
    seconds: float
    peaks_bytes: dict[str, int]
    recordings: tuple[Path, ...]
    partial: tuple[Path, ...]


def run_program(
    command: Sequence[str], runs: int, out: Path, time_limit: float, say: Callable[[str], None]
) -> tuple[ProgramRun, ...]:
    """Run a user's program in fresh processes, each with a folder of its own in `out`; those that were begun.

    time_limit  of each run [s]; 0: none
    say         gets a line at the begin and at the end of each run

    UsageError where there is no such program; otherwise raises as `record`.
    """
    arguments = ["gpusimbench.recorder.programs", str(runs), str(out), f"{time_limit:g}", *command]
    returncode, output, said = _run_cli(arguments, lambda told: None if told.startswith(PROGRAMS) else say(told))
    if returncode == ExitCode.USAGE:
        raise UsageError(_refusal(said, PROGRAMS))
    try:
        made: list[dict[str, Any]] = json.loads(output)["runs"]
        paths = ("recordings", "partial")
        return tuple(
            ProgramRun(**{**run, "folder": Path(run["folder"]), **{key: tuple(map(Path, run[key])) for key in paths}})
            for run in made
        )
    except (ValueError, LookupError, TypeError):
        raise GsbError(f"the program was not run: {_refusal(said, PROGRAMS)}") from None


def _run_cli(arguments: Sequence[str], say: Callable[[str], None]) -> tuple[int, bytes, list[str]]:
    """Exit code, standard output and last lines on standard error of a module of the recorder."""
    with tempfile.TemporaryFile() as printed:
        returncode, said = _run([sys.executable, "-P", "-m", *arguments], printed, say)
        printed.seek(0)
        return returncode, printed.read(_MOST_BYTES), said


def _run(command: Sequence[str], printed: IO[bytes], say: Callable[[str], None]) -> tuple[int, list[str]]:
    said: deque[str] = deque(maxlen=_KEPT_LINES)
    try:
        # in a session of its own, so that an interruption reaches it once, through this process
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.PIPE, text=True, errors="replace",
            start_new_session=True, preexec_fn=signalled_at_its_end(signal.SIGTERM, os.getpid()),
        )  # fmt: skip
    except OSError as error:
        raise GsbError(f"cannot start {COMMAND}: {error.strerror}") from None
    interrupted = False
    with child:
        assert child.stderr is not None
        while True:
            try:
                for line in child.stderr:
                    said.append(line.rstrip("\n"))
                    say(said[-1])
                child.wait()
                break
            except KeyboardInterrupt:
                interrupted = True
                with suppress(ProcessLookupError):
                    child.send_signal(signal.SIGINT)
    if interrupted:
        raise KeyboardInterrupt
    return child.returncode, list(said)


def as_path(path: Path) -> str:
    """A path that no command takes for an option."""
    text = str(path)
    return f"./{text}" if text.startswith("-") else text  # which is no option


def _refusal(said: Sequence[str], command: str = COMMAND) -> str:
    mark = f"{command}: "
    refusals = [line.removeprefix(mark) for line in said if line.startswith(mark)]
    return refusals[-1] if refusals else (said[-1] if said else "it did not say why")


def _parse_runs(output: bytes, returncode: int, said: Sequence[str]) -> tuple[Made, ...]:
    try:
        runs: list[dict[str, Any]] = json.loads(output)["runs"]
        return tuple(Made(r["status"], r["reason"], Path(r["file"]) if r["file"] else None) for r in runs)
    except (ValueError, LookupError, TypeError):
        raise GsbError(f"{COMMAND} ended with exit code {returncode} and no result: {_refusal(said)}") from None
