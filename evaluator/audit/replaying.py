"""Replays, made by gsb-record in a process of its own: reading recordings needs no simulator, running them does."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from gpusimbench.evaluator.compute.recorder import COMMAND, Made, as_path, record

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
    """

    out: Path
    runs: int = 1
    python: Path | None = None
    timeout: float | None = None
    options: tuple[str, ...] = ()
    phases: str | None = None
    models: bool = False

    def within(self, ran: float) -> ReplayPlan:
        """The same with a time limit: 20 times what the original took [s], at least ten minutes, at most a day."""
        if self.timeout is not None:
            return self
        return replace(self, timeout=float(min(max(_LEAST_S, math.ceil(_LONGER * ran)), _MOST_S)))

    def arguments(self, recording: Path) -> list[str]:
        """Of gsb-record, for a recording."""
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


@dataclass(frozen=True)
class Replays:
    """What became of a recording's replays.

    command  as a user would type it
    made     those that were begun
    refused  why none was; empty where at least one was
    """

    command: str
    made: tuple[Made, ...]
    refused: str


def make_replays(recording: Path, plan: ReplayPlan, say: Callable[[str], None]) -> Replays:
    """Run gsb-record and wait for its end; what it says on the way goes to `say`, line by line. Raises as `record`."""
    given = plan.arguments(recording)
    made, refused = record(given, say)
    return Replays(shlex.join([COMMAND, *given]), made, refused)
