"""Replays, made by gsb-record in a process of its own: reading recordings needs no simulator, running them does."""

from __future__ import annotations

import json
import math
import shlex
import signal
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

from gpusimbench.schemas.errors import ExitCode, GsbError

_COMMAND = "gsb-record"
_KEPT_LINES = 50
_MOST_BYTES = 16 << 20  # of what it prints on standard output

# A file says how long its run took, and its options may ask for any amount of work: neither is to be trusted.
_LEAST_S, _MOST_S, _LONGER = 600, 86_400, 20


@dataclass(frozen=True)
class ReplayPlan:
    """How replays are made, as of gsb-record's arguments.

    out      folder of their recordings
    runs     how many
    python   interpreter that makes them; None: whichever gsb-record chooses
    timeout  of each [s]; 0: none; None: by what the original took, see `within`
    options  NAME=VALUE, instead of what was recorded
    phases   comma separated; None: those that were recorded
    """

    out: Path
    runs: int = 1
    python: Path | None = None
    timeout: float | None = None
    options: tuple[str, ...] = ()
    phases: str | None = None

    def within(self, ran: float) -> ReplayPlan:
        """The same with a time limit: 20 times what the original took [s], at least ten minutes, at most a day."""
        if self.timeout is not None:
            return self
        return replace(self, timeout=float(min(max(_LEAST_S, math.ceil(_LONGER * ran)), _MOST_S)))

    def arguments(self, recording: Path) -> list[str]:
        """Of gsb-record, for a recording."""
        given = ["--replay", _as_path(recording), "--runs", str(self.runs), "--out", _as_path(self.out)]
        if self.python is not None:
            given += ["--python", _as_path(self.python)]
        if self.timeout:
            given += ["--timeout", f"{self.timeout:g}"]
        if self.phases is not None:
            given.append(f"--phases={self.phases}")
        given += [f"--option={option}" for option in self.options]
        return given


@dataclass(frozen=True)
class Replay:
    """One replay: how it ended, and its recording; None where nothing was written."""

    status: str
    reason: str
    path: Path | None


@dataclass(frozen=True)
class Replays:
    """What became of a recording's replays.

    command  as a user would type it
    made     those that were begun
    refused  why none was; empty where at least one was
    """

    command: str
    made: tuple[Replay, ...]
    refused: str


def make_replays(recording: Path, plan: ReplayPlan, say: Callable[[str], None]) -> Replays:
    """Run gsb-record and wait for its end; what it says on the way goes to `say`, line by line.

    GsbError where it cannot be started or does not say what it did. An interruption is passed on to it, and raised
    again once it has ended.
    """
    given = plan.arguments(recording)
    with tempfile.TemporaryFile() as printed:
        returncode, said = _run(
            [sys.executable, "-P", "-m", "gpusimbench.recorder.cli", *given, "--json"], printed, say
        )
        printed.seek(0)
        output = printed.read(_MOST_BYTES)
    command = shlex.join([_COMMAND, *given])
    if returncode == ExitCode.USAGE and not output:
        return Replays(command, (), _refusal(said))
    return Replays(command, _made(output, returncode, said), "")


def _run(command: Sequence[str], printed: IO[bytes], say: Callable[[str], None]) -> tuple[int, list[str]]:
    said: deque[str] = deque(maxlen=_KEPT_LINES)
    try:
        # in a session of its own, so that an interruption reaches it once, through this process
        child = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=printed, stderr=subprocess.PIPE, text=True, errors="replace",
            start_new_session=True,
        )  # fmt: skip
    except OSError as error:
        raise GsbError(f"cannot start {_COMMAND}: {error.strerror}") from None
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


def _as_path(path: Path) -> str:
    text = str(path)
    return f"./{text}" if text.startswith("-") else text  # which is no option


def _refusal(said: Sequence[str]) -> str:
    mark = f"{_COMMAND}: "
    refusals = [line.removeprefix(mark) for line in said if line.startswith(mark)]
    return refusals[-1] if refusals else (said[-1] if said else "it did not say why")


def _made(output: bytes, returncode: int, said: Sequence[str]) -> tuple[Replay, ...]:
    try:
        runs: list[dict[str, Any]] = json.loads(output)["runs"]
        return tuple(Replay(r["status"], r["reason"], Path(r["file"]) if r["file"] else None) for r in runs)
    except (ValueError, LookupError, TypeError):
        raise GsbError(f"{_COMMAND} ended with exit code {returncode} and no result: {_refusal(said)}") from None
