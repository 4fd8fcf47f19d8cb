"""Replays, made by gsb-record in a process of its own: reading recordings needs no simulator, running them does."""

from __future__ import annotations

import math
import shlex
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import COMMAND, Made, ProgramRun, as_path, record, run_program
from gpusimbench.evaluator.read.recording import Recording
from gpusimbench.schemas.errors import RecordingError, UsageError

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
    models   whether the model files that recordings carry may be loaded
    command  the user's program that made the recording, as a shell takes it, {seed} for the recorded seed; it is run
             instead of gsb-record; None: gsb-record is
    """

    out: Path
    runs: int = 1
    python: Path | None = None
    timeout: float | None = None
    options: tuple[str, ...] = ()
    phases: str | None = None
    models: bool = False
    command: str | None = None

    def within(self, ran: float) -> ReplayPlan:
        """The same with a time limit: 20 times what the original took [s], at least ten minutes, at most a day.

        The user's own program has none, since no file decides what it does.
        """
        if self.timeout is not None or self.command is not None:
            return self
        return replace(self, timeout=float(min(max(_LEAST_S, math.ceil(_LONGER * ran)), _MOST_S)))

    def arguments(self, recording: Path) -> list[str]:
        """Arguments of gsb-record that replay a recording."""
        given = ["--replay", as_path(recording), "--runs", str(self.runs), "--out", as_path(self.out)]
        if self.python is not None:
            given += ["--python", as_path(self.python)]
        if self.timeout:
            given += ["--timeout", f"{self.timeout:g}"]
        if self.phases is not None:
            given.append(f"--phases={self.phases}")
        if self.models:
            given.append("--allow-model")
        given += [f"--option={option}" for option in self.options]
        return given

    def program(self, seed: int) -> list[str]:
        """Words of the user's command. UsageError where a shell would not take it."""
        assert self.command is not None
        try:
            words = shlex.split(self.command)
        except ValueError as error:
            raise UsageError(f"--command '{self.command}' is no command: {error}") from None
        if not words:
            raise UsageError(
                "--command is the program and its arguments as one quoted argument, such as 'python train.py'"
            )
        return [word.replace("{seed}", str(seed)) for word in words]


@dataclass(frozen=True)
class Replays:
    """What became of a recording's replays.

    command  as a user would type it
    made     those that were begun
    refused  why none was; empty where at least one was
    seconds  from the start of the first to the end of the last [s]
    """

    command: str
    made: tuple[Made, ...]
    refused: str
    seconds: float = 0.0


def make_replays(original: Recording, path: Path, plan: ReplayPlan, say: Callable[[str], None]) -> Replays:
    """Run gsb-record, or the user's program, and wait for its end; what is said on the way goes to `say`, by line.

    path  of the original

    Raises as `record`.
    """
    begun = time.monotonic()
    if plan.command is not None:
        words = plan.program(original.configuration.seed)
        runs = run_program(words, plan.runs, plan.out, plan.timeout or 0, say)
        took = time.monotonic() - begun
        return Replays(shlex.join(words), tuple(_recording_beside(run, original, path.name) for run in runs), "", took)
    given = plan.arguments(path)
    made, refused = record(given, say)
    return Replays(shlex.join([COMMAND, *given]), made, refused, time.monotonic() - begun)


def _recording_beside(run: ProgramRun, original: Recording, name: str) -> Made:
    """Of a program's run the recording that belongs beside the original: that of its name, or the only one alike."""
    if run.status != "ended":
        return Made("stopped" if run.status == "timeout" else "failed", f"the program {run.reason}", None)
    found, reasons = [], []
    for path in run.recordings:
        try:
            recording = Recording(path)
        except RecordingError as error:
            reasons.append(str(error))
            continue
        if _alike(recording, original):
            found.append(recording)
    named = [recording for recording in found if recording.path.name == name] or found
    if len(named) != 1:
        wrote = f"the program wrote {len(run.recordings)} recordings into {run.folder}, of which {len(found)} have the"
        why = f"{wrote} simulator, scene, environments and steps of the original"
        return Made("failed", "; ".join([why, *reasons]), None)
    return Made(named[0].status, named[0].reason, Path(str(named[0].path)))


def _alike(a: Recording, b: Recording) -> bool:
    one, other = a.configuration, b.configuration
    return all(getattr(one, of) == getattr(other, of) for of in ("simulator", "scene", "n_env", "dt", "steps"))
